"""Seeded runs in other conditions that have to hold their object."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from feasigrasp.scenario.files import dump_scenario
from feasigrasp_lab.runs.hardware_pair import run_pair
from tests.held import assert_held, seeded


@pytest.mark.parametrize(
    ("name", "model", "controller"),
    [
        pytest.param("ReachCircularMocap", "small_box", "joint", id="in joint space"),
        pytest.param("Static", "soup_can", "task", id="at rest"),
        pytest.param("ReachObstacle", "small_box", "task", id="beside the wall"),
    ],
)
def test_an_object_is_held(name, model, controller):
    assert_held(name, model, controller)


def test_an_object_is_held_over_two_processes():
    """Cell and controller exchange the drivers' messages, at a quarter of real time."""
    scenario = seeded("ReachLinearMocap", "small_box", "task")
    # In a process of its own: LCM's select() aborts one with more than 1024 open files, which
    # renderers of earlier tests leave.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pair = pool.submit(run_pair, "held", dump_scenario(scenario), rate=0.25)
        metrics = pair.result()["metrics"]
    assert metrics["grasp_held"] is True, metrics["cause"]
