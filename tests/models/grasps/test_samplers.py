"""Samplers without their filter: what is proposed, as it comes."""

import numpy as np
import pytest

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.samplers import make_sampler, sampler_names
from feasigrasp.models.shape.gpdf import fit_gpdf

BALL = fit_gpdf(sphere_points(128, 0.03))


@pytest.mark.parametrize("name", sampler_names())
def test_without_the_filter_nothing_is_judged_on_the_field(name):
    alone = make_sampler(name, filtered=False, n_grasps=16)(BALL)
    assert 0 < len(alone) <= 16
    assert set(alone.rejected) <= {"near copy"}
    assert (np.diff(alone.score) <= 0.0).all()
    np.testing.assert_allclose(np.linalg.det(alone.X_OG[:, :3, :3]), 1.0, atol=1e-5)


def test_the_filter_is_what_makes_the_difference():
    """A wall behind the ball leaves no room for the hand; only the filter sees it."""
    wall = np.stack(np.meshgrid([0.033, 0.036], *[np.linspace(-0.1, 0.1, 15)] * 2), -1)
    field = fit_gpdf(np.concatenate([sphere_points(128, 0.03), wall.reshape(-1, 3)]))
    alone = make_sampler("antipodal", filtered=False)(field)
    judged = make_sampler("antipodal")(field)
    assert judged.rejected["gripper collides"] > 0
    assert "gripper collides" not in alone.rejected and len(alone) > 0
