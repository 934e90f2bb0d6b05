"""The arithmetic of the sampler's evaluation, on records whose answers are known."""

import csv

import numpy as np
import pytest
import trimesh

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.measures.grasps import set_measures
from feasigrasp_lab.results.statistics import average_precision, resampled
from feasigrasp_lab.studies.sampler import make_samplers, summary_rows, write_records
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.held_out_objects import FIRST_SEED, held_out_objects, make_object
from feasigrasp_lab.training.data.household_shapes import HELD_OUT


def test_average_precision_by_hand():
    score = np.array([0.9, 0.8, 0.7, 0.6])
    assert average_precision(score, np.array([True, True, False, False])) == 1.0
    found = average_precision(score, np.array([False, True, False, True]))
    assert found == pytest.approx((1 / 2 + 2 / 4) / 2)
    assert np.isnan(average_precision(score, np.zeros(4, dtype=bool)))


def test_a_random_score_has_the_base_rate_as_average_precision():
    rng = np.random.default_rng(0)
    positive = rng.random(20000) < 0.3
    assert average_precision(rng.random(20000), positive) == pytest.approx(0.3, abs=0.02)


def test_the_interval_of_resampled_means_is_that_of_means():
    values = np.random.default_rng(0).normal(size=200)
    estimate = resampled(list(values), lambda drawn: float(np.mean(drawn)))
    assert estimate.value == pytest.approx(values.mean())
    half = 1.96 * values.std() / np.sqrt(200)
    assert estimate.high - estimate.low == pytest.approx(2 * half, rel=0.2)


def test_grasps_are_judged_on_the_mesh():
    """A 40 mm cube: along an axis, along a diagonal, and with the palm inside."""
    truth, gripper = TrueGrasps(trimesh.creation.box([0.04] * 3)), ParallelGripper()
    c = np.sqrt(0.5)
    turned = np.array([[c, -c, 0, 0], [c, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    inside = np.eye(4)
    inside[2, 3] = 0.05
    grasps = GraspSet(np.stack([np.eye(4), turned, inside]), np.full(3, 0.04), [0.9, 0.8, 0.7])
    measured = set_measures(grasps, truth, gripper)
    assert (measured["grasps"], measured["valid"], measured["top_valid"]) == (3, 1, 1)
    assert measured["is_valid"] == [1, 0, 0]
    assert set_measures(GraspSet.empty(), truth, gripper)["top_valid"] is None


def a_set(name, condition, grasps, valid, graspable=1):
    return {
        "kind": "set", "object": name, "graspable": graspable, "view": 0, "preset": "default",
        "condition": condition, "grasps": grasps, "valid": valid, "antipodal": valid,
        "free": grasps, "top_valid": int(valid > 0) if grasps else None, "cpu_ms": 1.0,
    }  # fmt: skip


def a_hold(name, choice, held, graspable=1):
    return {
        "kind": "hold", "object": name, "graspable": graspable, "view": 0, "preset": "default",
        "condition": "1view", "choice": choice, "held": held, "why": "held" if held else "dropped",
    }  # fmt: skip


def a_proposal(name, condition, contact, is_contact):
    return {
        "kind": "proposal", "object": name, "graspable": 1, "view": 0, "preset": "default",
        "condition": condition, "contact": contact, "is_contact": is_contact,
        "width_error": [0.001, 0.003], "closing_error": [4.0, 8.0], "approach_free": [1, 0],
        "equivariance_error": 1e-13,
    }  # fmt: skip


@pytest.fixture
def records():
    return [
        a_set("a", "1view", 30, 27), a_set("b", "1view", 8, 2), a_set("c", "1view", 0, 0),
        a_set("d", "1view", 0, 0, graspable=0), a_set("a", "3views", 20, 20),
        a_hold("a", "top1", 1), a_hold("b", "top1", 0), a_hold("d", "top1", 0, graspable=0),
        a_proposal("a", "1view", [0.9, 0.1], [1, 0]), a_proposal("a", "true", [0.1, 0.9], [1, 0]),
    ]  # fmt: skip


def test_both_networks_get_the_same_help():
    samplers = make_samplers()
    assert {name: getattr(sampler, "top_up", None) for name, sampler in samplers.items()} == {
        "antipodal": None, "diffusion": None,
        "default": True, "default.alone": False, "paper": True, "paper.alone": False,
    }  # fmt: skip
    assert samplers["paper"].network is not samplers["default"].network
    assert samplers["paper"].network is samplers["paper.alone"].network


def test_rows_are_what_the_records_say(records):
    rows = {row.name: row for row in summary_rows(records)}
    assert rows["sampler.precision.1view"].value == pytest.approx(29 / 38)
    assert rows["sampler.precision.1view.per_view"].value == pytest.approx((0.9 + 0.25) / 2)
    assert rows["sampler.precision.3views"].value == 1.0
    assert rows["sampler.coverage_percent"].value == pytest.approx(200 / 3)
    assert rows["sampler.coverage_percent"].n == 3  # what cannot be grasped is not asked for
    assert rows["sampler.ten_offered_percent"].value == pytest.approx(100 / 3)
    assert rows["sampler.held_top1_percent"].value == 50.0
    assert "sampler.held_random_percent" not in rows
    assert rows["sampler.contact_ap.completed"].value == 1.0
    assert rows["sampler.contact_ap.true"].value == 0.5
    assert rows["sampler.width_mm"].value == pytest.approx(2.0)
    assert rows["sampler.closing_deg"].value == pytest.approx(6.0)
    assert rows["sampler.approach_valid_percent"].value == 50.0
    assert rows["sampler.equivariance.f64"].value == 1e-13


def test_raw_files_have_a_line_per_record(records, tmp_path):
    write_records(records, tmp_path)
    lines = {}
    for kind in ("set", "hold", "proposal"):
        with (tmp_path / f"{kind}s.csv").open() as file:
            lines[kind] = list(csv.DictReader(file))
    assert {kind: len(found) for kind, found in lines.items()} == {
        "set": 5, "hold": 3, "proposal": 2,
    }  # fmt: skip
    assert lines["proposal"][0]["contact_ap"] == "1"


def test_generated_objects_are_of_families_held_out():
    found = held_out_objects("held-out", 6, 0)
    assert len(found) == 6
    families = {what.split("/")[1] for what in found.values()}
    assert families == set(HELD_OUT)
    assert all(int(what.split("/")[2]) >= FIRST_SEED for what in found.values())
    assert make_object(next(iter(found.values()))).extents.max() < 0.3
    assert held_out_objects("held-out", 6, 1).keys().isdisjoint(found)
