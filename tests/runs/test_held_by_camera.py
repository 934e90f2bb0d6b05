"""Seeded runs by the wrist camera alone that have to hold their object."""

import pytest

from tests.held import assert_held


@pytest.mark.parametrize(
    ("model", "controller"),
    [
        ("small_box", "task"),
        ("mustard_bottle", "task"),
        ("mustard_bottle", "joint"),
        ("soup_can", "joint"),
    ],
)
def test_an_object_is_held_by_the_camera_alone(model, controller):
    assert_held("ReachLinear", model, controller)
