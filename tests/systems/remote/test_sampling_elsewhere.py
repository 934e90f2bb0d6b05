"""Grasps in a process of its own are sampled in time, whichever images are posted."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.scenario.files import dump_scenario
from feasigrasp.scenario.parts import Part
from feasigrasp.systems.ports import PeriodicState, declare_output
from feasigrasp.systems.remote.served import Served
from feasigrasp.systems.stages import remote
from tests.pipeline import scenario


class NewFields(LeafSystem):
    """Another field at every look."""

    def __init__(self, period):
        super().__init__()
        points = np.random.default_rng(0).normal(size=(100, 3))
        points *= 0.03 / np.linalg.norm(points, axis=1, keepdims=True)
        field = PeriodicState(self, None, period, lambda _: fit_gpdf(points))
        declare_output(self, "gpdf", field.Eval, {field.ticket()})


@pytest.mark.parametrize("every", [1, 4, 7])
def test_grasps_are_sampled_no_later_than_a_post_after_their_rest(every, monkeypatch):
    config, sampled, now = scenario("ReachLinear"), [], 0.0
    period = config.tracker.image_period

    def sampler(_):
        sampled.append(now)
        return GraspSet.empty({"a reason": 1})

    parts = {Part.PERCEPTION: NewFields(period), Part.SAMPLER: sampler}
    monkeypatch.setattr(remote, "make_part", lambda part, *_: parts[part])
    served = Served(remote.make_object_stage(dump_scenario(config)))
    for k in range(0, 120, every):
        now = k * period
        served.looked(now, {})
    first, *gaps = np.diff(sampled) - 0.25 - 1e-9
    assert len(gaps) > 5 and max(gaps) <= every * period
    assert first <= 2 * every * period  # what is found first is remembered at the next post
