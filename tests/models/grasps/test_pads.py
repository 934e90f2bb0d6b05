"""What pads bear, against closed forms of patch contact and numerical integrals."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.payload import (
    contact_pressure,
    grip_of,
    moment_limits,
    pad_cells,
    pressure_centre,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.models.shape.gpdf import fit_gpdf

FORCE, STIFFNESS = 40.0, 3e9


def fine_cells(width, height, n=201):
    y, z = (s * ((np.arange(n) + 0.5) / n - 0.5) for s in (width, height))
    y, z = np.meshgrid(y, z, indexing="ij")
    return y.ravel(), z.ravel(), width * height / n**2


def test_uniform_disc_bears_two_thirds_of_force_times_radius():
    radius = 0.012
    y, z, _ = fine_cells(2 * radius, 2 * radius)
    on_disc = np.hypot(y, z) <= radius
    force = np.where(on_disc, FORCE / on_disc.sum(), 0.0)
    assert moment_limits(y, z, force[None])[0, 0] == pytest.approx(2 / 3 * FORCE * radius, rel=2e-3)


def test_a_flat_pad_bears_the_integral_of_the_distance():
    gripper = ParallelGripper()
    y, z, area = pad_cells(gripper)
    pressure = contact_pressure(np.zeros((1, len(y))), area, STIFFNESS, FORCE)
    b, h = gripper.finger_width / 2, gripper.tip
    mean_arm = dblquad(np.hypot, -h, h, -b, b)[0] / (4 * b * h)
    np.testing.assert_allclose(pressure, FORCE / (4 * b * h))
    torsion, *bending = moment_limits(y, z, pressure * area)[0]
    assert torsion == pytest.approx(FORCE * mean_arm, rel=0.03)
    # Half of the force at a quarter of either side, on this side or that.
    np.testing.assert_allclose(bending, [FORCE * h / 2, FORCE * b / 2], rtol=0.05)


def test_a_cylinder_presses_as_the_elastic_foundation_says():
    """Parabolic gap: half width ``(3 N R / 2 k L)^(1/3)``, deepest pressure ``k b^2 / 2 R``."""
    radius, length = 0.03, 0.03
    y, z, area = fine_cells(length, 0.03, 401)
    pressure = contact_pressure((z**2 / (2 * radius))[None], area, STIFFNESS, FORCE)[0]
    b = (1.5 * FORCE * radius / (STIFFNESS * length)) ** (1 / 3)
    assert np.abs(z[pressure > 0]).max() == pytest.approx(b, rel=0.05)
    assert pressure.max() == pytest.approx(STIFFNESS * b**2 / (2 * radius), rel=0.02)
    # A strip much longer than wide bears a quarter of force times length.
    moment = moment_limits(y, z, pressure[None] * area)[0, 0]
    assert moment == pytest.approx(FORCE * length / 4, rel=0.05)


def test_pressure_bears_the_force_wherever_the_surface_is():
    rng = np.random.default_rng(0)
    y, z, area = pad_cells(WSG_50)
    gap = rng.uniform(-0.02, 0.02, (50, len(y)))
    pressure = contact_pressure(gap, area, STIFFNESS, FORCE)
    np.testing.assert_allclose(pressure.sum(axis=1) * area, FORCE)
    assert (pressure >= 0.0).all()
    # Where the pad is pressed in, pressure over stiffness and gap add up to its depth; elsewhere
    # the gap alone is more.
    depth = np.where(pressure > 0.0, pressure / STIFFNESS + gap, np.nan)
    assert (np.nanmax(depth, axis=1) - np.nanmin(depth, axis=1)).max() < 1e-12
    assert (gap >= np.nanmax(depth, axis=1, keepdims=True) - 1e-12)[pressure == 0.0].all()
    np.testing.assert_allclose(
        contact_pressure(gap + 0.1, area, STIFFNESS, FORCE), pressure, atol=1e-3
    )


def test_moment_is_about_the_centre_of_pressure():
    rng = np.random.default_rng(1)
    y, z = rng.normal(size=(2, 30))
    force = rng.uniform(0.0, 1.0, (3, 30))
    moment = moment_limits(y, z, force)
    np.testing.assert_allclose(moment_limits(y + 3.0, z - 2.0, force), moment)
    np.testing.assert_allclose(moment_limits(-z, y, force), moment[:, [0, 2, 1]])
    assert (moment[:, 1:] <= moment[:, :1]).all()
    np.testing.assert_allclose(
        pressure_centre(y + 3.0, z, force)[:, 0], pressure_centre(y, z, force)[:, 0] + 3.0
    )


def box_field(size):
    rng = np.random.default_rng(0)
    faces = rng.uniform(-0.5, 0.5, (1500, 3))
    faces[np.arange(1500), np.arange(1500) % 3] = rng.choice([-0.5, 0.5], 1500)
    return fit_gpdf(faces * size)


def grasps_at(*points, width):
    X_OG = np.tile(np.eye(4), (len(points), 1, 1))
    X_OG[:, :3, 3] = points
    return GraspSet(X_OG, np.full(len(points), width), np.ones(len(points)))


def test_faces_bear_more_than_a_ball():
    gripper = ParallelGripper()
    faces, _ = grip_of(box_field([0.04, 0.12, 0.12]), grasps_at((0, 0, 0), width=0.04), gripper)
    ball, _ = grip_of(fit_gpdf(sphere_points(400, 0.02)), grasps_at((0, 0, 0), width=0.04), gripper)
    flat = 2 * FORCE * 0.0153  # mean distance from the middle of 30 x 50 mm
    assert flat * 0.75 < faces[0, 0] < flat * 1.05
    assert ball[0, 0] < 0.5 * faces[0, 0]
    np.testing.assert_allclose(faces[0, 1:], 2 * FORCE * np.array([0.0125, 0.0075]), rtol=0.25)
    assert (ball[0, 1:] < 0.5 * faces[0, 1:]).all()


def test_pads_that_reach_beyond_an_edge_bear_where_the_object_is():
    """The centre of pressure is on the box, and the patch bears less than the whole pad."""
    field = box_field([0.04, 0.12, 0.12])
    moment, p_OP = grip_of(field, grasps_at((0, 0, 0), (0, 0, 0.06), width=0.04), ParallelGripper())
    assert abs(p_OP[0, 2]) < 0.004
    assert p_OP[1, 2] < 0.056
    assert moment[1, 0] < 0.9 * moment[0, 0]
