"""Seal and wrench limits of a suction cup, against closed forms."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.geometry.se3 import make_pose, so3_exp
from feasigrasp.models.grasps.grasp_set import GraspSet, MassEstimate, Rejection
from feasigrasp.models.grasps.payload import GRAVITY, CupLoad, needed_vacuum, with_loads
from feasigrasp.models.grasps.suction import (
    LIP,
    SuctionSampler,
    cup_points,
    filter_suction,
    mesh_heights,
    recheck_suction,
    seals,
    strain,
)
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.models.shape.gpdf import fit_gpdf

CUP = SuctionCup()
R, H = CUP.radius, CUP.height


def from_above(z, tilt=0.0, x=0.0, y=0.0):
    """A cup that looks down, with its lip at height z."""
    return make_pose(so3_exp([np.pi + tilt, 0.0, 0.0]), [x, y, z])


def heights(mesh, X_OG):
    return mesh_heights(np.asarray(mesh.vertices), np.asarray(mesh.faces), X_OG, CUP)


def field_of(mesh, count=800):
    return fit_gpdf(np.asarray(trimesh.sample.sample_surface(mesh, count, seed=0)[0]))


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0, 8.0])
def test_strain_of_a_tilted_plane(tilt_deg):
    tilt = np.deg2rad(tilt_deg)
    plate = trimesh.creation.box([0.2, 0.2, 0.02])
    found = heights(plate, from_above(0.01, tilt))
    np.testing.assert_allclose(np.ptp(found[:LIP]), 2.0 * R * np.tan(tilt), atol=1e-9)
    cone = np.hypot(R, H + R * np.tan(tilt)) / np.hypot(R, H) - 1.0
    assert strain(found[None, :LIP], CUP)[0] == pytest.approx(cone, abs=1e-9)
    assert seals(found[None], CUP)[0] == (cone <= CUP.max_strain)


@pytest.mark.parametrize(("radius", "closes"), [(0.020, False), (0.024, True), (0.05, True)])
def test_the_lip_lies_on_a_sphere(radius, closes):
    """It is a circle, without strain; the cup seals if the sphere is not in its apex."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    sag = radius - np.sqrt(radius**2 - R**2)
    found = heights(ball, from_above(radius - sag))
    expected = radius - sag - np.sqrt(radius**2 - np.square(cup_points(CUP)).sum(axis=1))
    np.testing.assert_allclose(found, expected, atol=5e-5)
    assert strain(found[None, :LIP], CUP)[0] < 5e-3
    assert seals(found[None], CUP)[0] == closes == (sag < H / 2)


@pytest.mark.parametrize(("radius", "closes"), [(0.033, False), (0.06, True)])
def test_the_lip_bends_over_a_cylinder(radius, closes):
    can = trimesh.creation.cylinder(radius, 0.2, sections=400)
    X_OG = make_pose(so3_exp([np.pi / 2, 0.0, 0.0]), [0.0, radius - 0.001, 0.0])
    found = heights(can, X_OG)
    across = cup_points(CUP)[:, 0]
    expected = radius - 0.001 - np.sqrt(radius**2 - across**2)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    middle = expected[:LIP].mean()
    cone = np.hypot(R, H + expected[:LIP] - middle) / np.hypot(R, H) - 1.0
    assert strain(found[None, :LIP], CUP)[0] == pytest.approx(np.abs(cone).max(), abs=1e-4)
    assert seals(found[None], CUP)[0] == closes


@pytest.mark.parametrize(
    ("pose", "closes"),
    [
        (from_above(0.0095), True),
        (from_above(0.0095, x=0.0845), True),
        (from_above(0.0095, x=0.0855), False),  # the lip hangs over the edge
        (from_above(0.0115), False),  # above the surface
        (from_above(0.0035), False),  # crushed
    ],
)
def test_the_cup_has_to_be_on_the_surface_with_all_of_its_lip(pose, closes):
    plate = trimesh.creation.box([0.2, 0.2, 0.02])
    assert seals(heights(plate, pose)[None], CUP)[0] == closes


def test_no_seal_over_a_hole():
    plate = trimesh.creation.annulus(0.006, 0.1, 0.02)
    assert not seals(heights(plate, from_above(0.0095))[None], CUP)[0]
    assert seals(heights(plate, from_above(0.0095, x=0.04))[None], CUP)[0]


def test_limits_of_the_cup_by_hand():
    """Pull, friction, torsion and bending, each alone, and all of them."""
    mu = CUP.friction
    assert CUP.vacuum_force == pytest.approx(60e3 * np.pi * 0.015**2)
    for force, moment, expected in (
        ([0.0, 0.0, 7.0], [0.0, 0.0, 0.0], 7.0),
        ([3.0, 4.0, 0.0], [0.0, 0.0, 0.0], 5.0 / mu),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.06], 0.06 / R / mu),
        ([0.0, 0.0, 0.0], [0.03, 0.04, 0.0], 2.0 * 0.05 / R),
        ([0.0, 0.0, -5.0], [0.0, 0.0, 0.0], -5.0),
        ([0.0, 4.0, 2.0], [0.0, 0.0, 3.0 * R], 2.0 + 5.0 / mu),
    ):
        assert needed_vacuum(force, moment, CUP) == pytest.approx(expected)


def test_bending_opens_the_side_where_the_line_load_vanishes():
    """The load along the ring carries normal force and moment, and is zero at one point."""
    moment = 0.21
    normal = float(needed_vacuum([0.0, 0.0, 0.0], [moment, 0.0, 0.0], CUP))
    angle = np.arange(720) * 2.0 * np.pi / 720
    load = (normal + 2.0 * moment * np.cos(angle) / R) / (2.0 * np.pi * R)
    arc = R * 2.0 * np.pi / 720
    assert np.sum(load) * arc == pytest.approx(normal)
    assert np.sum(load * R * np.cos(angle)) * arc == pytest.approx(moment)
    assert load.min() == pytest.approx(0.0, abs=1e-9)


def test_load_of_a_hanging_object():
    """From above a cup bears the weight, from the side its friction and bending do."""
    depth = 0.05
    body = MassEstimate(1.0, 0.05, np.zeros(3), 0.0)
    X_OG = from_above(depth)
    load = CupLoad(X_OG[None, :3, :3], -X_OG[None, :3, 3], body, CUP)
    hanging = load.per_kilogram([0.0, 0.0, -1.0])[0]
    lying = load.per_kilogram([1.0, 0.0, 0.0])[0]
    aside = max(1.0 / CUP.friction, 2.0 * depth / R)
    assert (lying - hanging) * CUP.vacuum_force == pytest.approx(GRAVITY * (aside - 1.0))
    assert load.per_kilogram()[0] >= max(hanging, lying)
    both = load.joined(load).select(np.array([1]))
    assert both.per_kilogram([0.0, 0.0, -1.0])[0] == hanging


def test_grasps_of_a_box_truly_seal():
    """On the true surface, with the approach against its normal and the center in the lip."""
    box = load_object("small_box")
    field = field_of(box.mesh)
    grasps = SuctionSampler(CUP)(field)
    assert len(grasps) >= 8
    found = np.array([heights(box.mesh, X) for X in grasps.X_OG])
    assert seals(found, CUP).all()
    np.testing.assert_allclose(found.mean(axis=1), -CUP.press, atol=0.001)
    most = np.abs(grasps.X_OG[:, :3, 2]).max(axis=1)
    assert (most > np.cos(np.deg2rad(8.0))).all()  # along a face's normal
    kept = recheck_suction(field, grasps, CUP)
    assert set(kept.id) == set(grasps.id)


def test_turns_about_the_normal_are_grasps_of_their_own():
    sampler = SuctionSampler(CUP, n_candidates=40)
    X_OG, _, _ = sampler.candidates(field_of(load_object("small_box").mesh, 400))
    places = len(X_OG) // 4
    for turn in range(1, 4):
        one, other = X_OG[:places], X_OG[turn * places : (turn + 1) * places]
        np.testing.assert_allclose(one[:, :3, 2:], other[:, :3, 2:], atol=1e-12)
        cosine = np.einsum("ni,ni->n", one[:, :3, 0], other[:, :3, 0])
        np.testing.assert_allclose(cosine, np.cos(turn * np.pi / 4), atol=1e-9)


def test_a_curved_object_is_refused_with_words():
    grasps = SuctionSampler(CUP)(field_of(load_object("ball").mesh))
    assert len(grasps) == 0
    assert grasps.rejected[Rejection.NOT_FLAT] > 100
    assert Rejection.NOT_FLAT == "not flat enough for the cup"


def test_a_cup_that_is_not_flush_is_no_grasp():
    field = field_of(load_object("small_box").mesh)
    good = SuctionSampler(CUP)(field).X_OG[:4]
    for turn, kept in ((0.0, 4), (25.0, 0)):
        X = good @ make_pose(so3_exp([np.deg2rad(turn), 0.0, 0.0]), np.zeros(3))
        assert len(filter_suction(field, X, CUP)) == kept


def test_payload_prefers_the_middle_of_a_heavy_plate():
    plate = trimesh.creation.box([0.16, 0.16, 0.03])
    field = field_of(plate, 1200)
    X = np.array([from_above(0.013), from_above(0.013, x=0.05)])
    grasps = GraspSet(X, np.full(2, 2 * R), np.ones(2))
    load = with_loads(field, grasps, CUP, 0.6).load
    middle, edge = load.probability([0.0, 0.0, -1.0])
    assert middle > 0.9 > 0.5 > edge
