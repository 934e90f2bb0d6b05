"""The three sources of configurations: what is measured, and that the exact one is exact."""

import numpy as np
import pytest

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.measures import ik_sources


@pytest.fixture(scope="module")
def source_rows():
    patch = pytest.MonkeyPatch()
    patch.setattr(ik_sources, "QUICK", ik_sources.Sizes(errors=300, diversity=20, timed=50))
    try:
        yield ik_sources.ik_source_rows(seed=1, quick=True)
    finally:
        patch.undo()


def test_sources_are_compared_on_the_same_figures(source_rows):
    by_source = {}
    for row in source_rows:
        by_source.setdefault(row.preset, set()).add(row.name)
    assert by_source["closed_form"] == by_source["dls"] == by_source["flow"]
    assert by_source["default"] == {"kinematics.flow_refined_percent"}
    table = ik_sources.format_source_table(source_rows)
    assert all(source in table for source in ik_sources.SOURCES)


def test_the_closed_form_is_the_exact_reference(source_rows):
    value = {row.name: row.value for row in source_rows if row.preset == "closed_form"}
    assert value["kinematics.reached_percent"] == 100.0
    assert value["kinematics.inside_limits_percent"] == 100.0
    assert value["kinematics.position_error_mm_mean"] < 1e-6
    assert value["kinematics.diversity_ratio"] == 1.0
    assert value["kinematics.branches"] > 6.0


def test_every_source_stays_inside_the_limits():
    poses = ik_sources.reachable_poses(100, seed=2)
    for name, source in ik_sources.SOURCES.items():
        q = source(poses, 3)
        assert q.shape == (100, 7), name
        assert (np.abs(q) <= IIWA_7.position_limits).all(), name
        np.testing.assert_array_equal(q, source(poses, 3), err_msg=name)


def test_poses_out_of_reach_have_no_closed_form():
    far = np.eye(4)[None].copy()
    far[0, :3, 3] = [2.0, 0.0, 0.0]
    assert np.isnan(ik_sources.from_closed_form(far, seed=0)).all()
