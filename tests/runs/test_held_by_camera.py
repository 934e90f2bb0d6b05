"""Seeded runs by the wrist camera alone that have to hold their object."""

import pytest

from tests.held import assert_held


@pytest.mark.parametrize("controller", ["task", "joint"])
@pytest.mark.parametrize("model", ["soup_can", "small_box", "mustard_bottle"])
def test_an_object_is_held_by_the_camera_alone(model, controller):
    assert_held("ReachLinear", model, controller)
