"""The arithmetic of the sampler's evaluation, on records whose answers are known."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp_lab.results.statistics import resampled
from feasigrasp_lab.studies.sampler import make_samplers, set_measures, summary_rows
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.held_out_objects import FIRST_SEED, held_out_objects, make_object
from feasigrasp_lab.training.data.household_shapes import HELD_OUT


def test_the_interval_of_resampled_means_is_that_of_means():
    values = np.random.default_rng(0).normal(size=200)
    estimate = resampled(list(values), lambda drawn: float(np.mean(drawn)))
    assert estimate.value == pytest.approx(values.mean())
    half = 1.96 * values.std() / np.sqrt(200)
    assert estimate.high - estimate.low == pytest.approx(2 * half, rel=0.2)


def test_grasps_are_judged_on_the_mesh():
    """A 40 mm cube: along an axis, along a diagonal, and with the palm inside."""
    truth = TrueGrasps(trimesh.creation.box([0.04] * 3))
    c = np.sqrt(0.5)
    turned = np.array([[c, -c, 0, 0], [c, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    inside = np.eye(4)
    inside[2, 3] = 0.05
    grasps = GraspSet(np.stack([np.eye(4), turned, inside]), np.full(3, 0.04), [0.9, 0.8, 0.7])
    measured = set_measures(grasps, truth)
    assert (measured["grasps"], measured["valid"], measured["top_valid"]) == (3, 1, 1)
    assert (measured["antipodal"], measured["free"]) == (1, 2)
    assert set_measures(GraspSet.empty(), truth)["top_valid"] is None


def a_set(name, condition, grasps, valid, graspable=1):
    return {
        "kind": "set", "object": name, "graspable": graspable, "view": 0, "preset": "default",
        "condition": condition, "grasps": grasps, "valid": valid, "antipodal": valid,
        "free": grasps, "top_valid": int(valid > 0) if grasps else None,
    }  # fmt: skip


def a_hold(name, held, graspable=1):
    return {
        "kind": "hold", "object": name, "graspable": graspable, "view": 0, "preset": "default",
        "condition": "1view", "held": held, "why": "held" if held else "dropped",
    }  # fmt: skip


@pytest.fixture
def records():
    return [
        a_set("a", "1view", 30, 27), a_set("b", "1view", 8, 2), a_set("c", "1view", 0, 0),
        a_set("d", "1view", 0, 0, graspable=0), a_set("a", "3views", 20, 20),
        a_hold("a", 1), a_hold("b", 0), a_hold("d", 0, graspable=0),
    ]  # fmt: skip


def test_both_networks_get_the_same_help():
    samplers = make_samplers()
    assert {name: getattr(sampler, "top_up", None) for name, sampler in samplers.items()} == {
        "default": True, "paper": True, "antipodal": None, "diffusion": None,
    }  # fmt: skip
    assert samplers["paper"].network is not samplers["default"].network


def test_rows_are_what_the_records_say(records):
    rows = {row.name: row for row in summary_rows(records)}
    assert rows["sampler.precision.1view"].value == pytest.approx(29 / 38)
    assert rows["sampler.precision.3views"].value == 1.0
    assert rows["sampler.coverage_percent"].value == pytest.approx(200 / 3)
    assert rows["sampler.coverage_percent"].n == 3  # what cannot be grasped is not asked for
    assert rows["sampler.held_top1_percent"].value == 50.0


def test_generated_objects_are_of_families_held_out():
    found = held_out_objects("held-out", 6, 0)
    assert len(found) == 6
    families = {what.split("/")[1] for what in found.values()}
    assert families == set(HELD_OUT)
    assert all(int(what.split("/")[2]) >= FIRST_SEED for what in found.values())
    assert make_object(next(iter(found.values()))).extents.max() < 0.3
    assert held_out_objects("held-out", 6, 1).keys().isdisjoint(found)
