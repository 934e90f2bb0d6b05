"""When faults are there, and what they make of images, poses, motions and commands."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.fault import (
    CommandNan,
    CommandWild,
    PoseFrozen,
    PoseJump,
    PoseLate,
    PoseNan,
)
from feasigrasp.models.faults.images import (
    CameraBlack,
    CameraGone,
    MaskDilated,
    MaskEmpty,
    MaskEroded,
    MaskShifted,
    MaskWhole,
    OnePlane,
    Outliers,
    View,
)
from feasigrasp.models.faults.object import ObjectMoved, ObjectPace, altered
from feasigrasp.models.objects.motion import HarmonicMotion

RNG_SEED = 3


def rng():
    return np.random.default_rng(RNG_SEED)


# ------------------------------------------------------------------------------------------ when


def test_a_fault_lasts_from_its_start_for_its_duration():
    fault = CameraGone(start=2.0, duration=0.5)
    assert [fault.active(t) for t in (0.0, 1.999, 2.0, 2.499, 2.5, 9.0)] == [0, 0, 1, 1, 0, 0]
    assert CameraGone(start=1.0).active(1e6)


def test_a_fault_comes_again():
    fault = CameraGone(start=1.0, duration=0.5, every=2.0)
    times = np.arange(0.0, 8.0, 0.25)
    expected = (times >= 1.0) & ((times - 1.0) % 2.0 < 0.5)
    assert [fault.active(t) for t in times] == list(expected)


@pytest.mark.parametrize("period", [0.005, 0.02, 1.0 / 30.0])
def test_rounding_of_times_adds_or_takes_no_tick(period):
    """A fault of n ticks has n of them, also where multiples of the period are not exact."""
    fault = PoseNan(start=30 * period, duration=30 * period, every=90 * period)
    for shift in (0, 90, 900):
        ticks = [k for k in range(shift, shift + 90) if fault.active(k * period)]
        assert ticks == list(range(shift + 30, shift + 60))


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (CameraGone(start=-1.0), "start is -1.0; give 0 to"),
        (CameraGone(start=math.inf), "start is inf"),
        (CameraGone(duration=math.nan), "duration is nan"),
        (CameraGone(duration=2.0, every=1.0), "every is 1.0, but it lasts 2.0 s"),
        (Outliers(share=1.5), r"faults\[0\] \(!Outliers\): share is 1.5; give 0 to 1"),
        (PoseJump(by=[1.0, 2.0]), "by is .*give x, y and z"),
        (PoseJump(by=[1.0, 2.0, math.nan]), "by is .*give -10 to 10"),
        (ObjectPace(ramp=0.0), "ramp is 0.0"),
    ],
)
def test_values_out_of_range_are_refused(fault, message):
    with pytest.raises(ScenarioError, match=message):
        fault.check("faults[0]")


# ---------------------------------------------------------------------------------------- images


def view(n=4000):
    """Points in front of a tilted camera, the first third of them on the object, some missing."""
    R_WC = Rotation.from_euler("xyz", [2.5, 0.3, -0.4]).as_matrix()
    p_WC = np.array([0.3, -0.1, 0.8])
    p_C = rng().uniform([-0.2, -0.2, 0.3], [0.2, 0.2, 0.6], (n, 3))
    points = (p_C @ R_WC.T + p_WC).T
    points[:, ::10] = np.inf
    return View(points, np.arange(n) < n // 3, p_WC, R_WC[:, 2])


def test_without_camera_nothing_is_seen():
    assert not np.isfinite(CameraGone().seen(view(), rng())).any()


def test_a_black_camera_sees_itself_in_every_pixel():
    seen = CameraBlack().seen(view(), rng())
    np.testing.assert_array_equal(seen, np.tile(view().p_WC[:, None], seen.shape[1]))


def test_an_object_on_one_plane_keeps_its_rays_and_its_surroundings():
    before = view()
    seen = OnePlane().seen(before, rng())
    finite = np.isfinite(before.points).all(axis=0)
    on = before.of_object & finite
    depth = before.axis @ (seen[:, on] - before.p_WC[:, None])
    true_depth = before.axis @ (before.points[:, on] - before.p_WC[:, None])
    np.testing.assert_allclose(depth, np.median(true_depth), rtol=1e-12)
    rays, true_rays = (p[:, on] - before.p_WC[:, None] for p in (seen, before.points))
    assert np.abs(np.cross(rays.T, true_rays.T)).max() < 1e-12
    np.testing.assert_array_equal(seen[:, ~on], before.points[:, ~on])


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_outliers_are_so_many_and_so_far_along_their_rays(share):
    before = view(20000)
    seen = Outliers(share=share, size=0.05).seen(before, rng())
    finite = np.isfinite(before.points).all(axis=0)
    np.testing.assert_array_equal(np.isfinite(seen).all(axis=0), finite)
    off = seen[:, finite] - before.points[:, finite]
    moved = np.linalg.norm(off, axis=0) > 0.0
    assert moved.mean() == pytest.approx(share, rel=0.15)
    np.testing.assert_allclose(np.linalg.norm(off[:, moved], axis=0), 0.05, rtol=1e-9)
    rays = before.points[:, finite][:, moved] - before.p_WC[:, None]
    assert np.abs(np.cross(off[:, moved].T, rays.T)).max() < 1e-12
    away = np.einsum("ij,ij->j", off[:, moved], rays) > 0.0
    assert away.mean() == pytest.approx(0.5, abs=0.1)


def disc(radius, shape=(60, 80), center=(30, 40)):
    rows, columns = np.indices(shape)
    return np.hypot(rows - center[0], columns - center[1]) <= radius


def test_an_eroded_or_dilated_disc_is_a_smaller_or_larger_disc():
    """To a pixel, by which the rim of a disc of pixels is uncertain."""
    for fault, inner, outer in ((MaskEroded(pixels=6), 9, 10.1), (MaskDilated(pixels=6), 20, 21.1)):
        mask = fault.mask(disc(15.0))
        assert not (disc(inner - 0.5) & ~mask).any() and not (mask & ~disc(outer)).any()


def test_masks_without_rim_stay_as_they_are():
    nothing, all_ = np.zeros((5, 6), dtype=bool), np.ones((5, 6), dtype=bool)
    np.testing.assert_array_equal(MaskDilated().mask(nothing), nothing)
    np.testing.assert_array_equal(MaskEroded().mask(all_), all_)


def test_a_shifted_mask_leaves_the_image_and_nothing_comes_in():
    mask = MaskShifted(columns=10, rows=-4).mask(disc(15.0))
    np.testing.assert_array_equal(mask, disc(15.0, center=(26, 50)))
    mask = MaskShifted(columns=-40, rows=0).mask(disc(15.0))
    np.testing.assert_array_equal(mask, disc(15.0, center=(30, 0)))
    assert not MaskShifted(columns=200).mask(disc(15.0)).any()


def test_a_mask_of_everything_or_nothing():
    assert MaskWhole().mask(disc(5.0)).all() and not MaskEmpty().mask(disc(5.0)).any()


# ----------------------------------------------------------------------------------------- poses


def pose(seed):
    X = np.eye(4)
    X[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    X[:3, 3] = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return X


def measured(fault, poses, period=0.01):
    """What is measured of poses that follow one another."""
    past, found = np.full((fault.depth(period), 4, 4), np.nan), []
    for k, X in enumerate(poses):
        t = period * k
        found.append(fault.measured(X, past, rng()) if fault.active(t) else X)
        past = fault.remembered(t, past, X)
    return found


def test_a_frozen_pose_is_the_last_one_bit_for_bit():
    poses = [pose(k) for k in range(10)]
    found = measured(PoseFrozen(start=0.03, duration=0.04), poses)
    for k, X in enumerate(found):
        np.testing.assert_array_equal(X, poses[2 if 3 <= k < 7 else k])


def test_a_pose_that_is_frozen_from_the_start_is_the_first():
    poses = [pose(k) for k in range(4)]
    for X in measured(PoseFrozen(), poses):
        np.testing.assert_array_equal(X, poses[0])


def test_it_freezes_again_where_it_is_then():
    poses = [pose(k) for k in range(8)]
    found = measured(PoseFrozen(start=0.01, duration=0.02, every=0.04), poses)
    for X, k in zip(found, (0, 0, 0, 3, 4, 4, 4, 7), strict=True):
        np.testing.assert_array_equal(X, poses[k])


def test_a_jump_is_as_far_and_turned_as_much_as_it_says():
    fault = PoseJump(by=[0.1, 0.0, -0.2], turn_deg=30.0, axis=[0.0, 0.0, 2.0])
    (X,) = measured(fault, [pose(0)])
    np.testing.assert_allclose(X[:3, 3] - pose(0)[:3, 3], [0.1, 0.0, -0.2])
    turn = Rotation.from_matrix(pose(0)[:3, :3].T @ X[:3, :3]).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, 0.0, np.deg2rad(30.0)], atol=1e-12)


def test_a_late_pose_is_so_old_and_so_noisy():
    poses = [pose(k) for k in range(30)]
    exact = measured(PoseLate(delay=0.1, position_noise=0.0, rotation_noise_deg=0.0), poses)
    assert np.isnan(exact[9]).all()
    for k in range(10, 30):
        np.testing.assert_allclose(exact[k], poses[k - 10], atol=1e-15)
    fault, same = PoseLate(delay=0.0), [pose(1)] * 400
    draws = np.random.default_rng(0)
    noisy = np.array([fault.measured(X, np.array([X]), draws) for X in same])
    assert (noisy[:, :3, 3] - pose(1)[:3, 3]).std(axis=0) == pytest.approx([0.005] * 3, rel=0.15)
    turns = Rotation.from_matrix(noisy[:, :3, :3] @ pose(1)[:3, :3].T).as_rotvec(degrees=True)
    assert turns.std(axis=0) == pytest.approx([3.0] * 3, rel=0.15)


def test_no_pose_is_not_a_number():
    assert np.isnan(measured(PoseNan(), [pose(0)])[0]).all()


# ---------------------------------------------------------------------------------------- object

MOTION = HarmonicMotion(
    center=np.array([0.5, 0.1, 0.55]),
    amplitude=np.array([0.1, 0.2, 0.05]),
    harmonic=np.array([1.0, 1.0, 2.0]),
    offset_deg=np.array([90.0, 0.0, 30.0]),
    rate=0.6,
    start_phase=0.4,
    spin_axis=np.array([1.0, 2.0, -0.5]),
    spin=0.7,
)
CHANGES = {
    "stops": [ObjectPace(start=1.0, duration=2.0)],
    "reverses": [ObjectPace(start=1.0, factor=-1.0)],
    "fast": [ObjectPace(start=1.0, duration=0.7, every=1.0, factor=5.0)],
    "moved": [ObjectMoved(start=1.0, duration=2.0, to=[0.0, 0.3, 0.1])],
    "moved again": [ObjectMoved(start=0.5, duration=1.0, every=1.6, ramp=0.4)],
    "both": [ObjectMoved(start=0.5, duration=1.0), ObjectPace(start=1.0, factor=3.0)],
}


def test_a_motion_without_faults_of_the_object_is_itself():
    assert altered(MOTION, [PoseNan()]) is MOTION


@pytest.mark.parametrize("name", CHANGES)
def test_velocity_and_acceleration_are_derivatives(name):
    motion, h = altered(MOTION, CHANGES[name]), 1e-6
    for t in np.linspace(0.1234, 6.3, 120):
        X, V, a = motion.state(t)
        (X0, V0, _), (X1, V1, _) = motion.state(t - h), motion.state(t + h)
        np.testing.assert_allclose((X1 - X0)[:3, 3] / (2 * h), V[3:], atol=1e-5)
        np.testing.assert_allclose((V1 - V0)[3:] / (2 * h), a, atol=1e-3)
        turn = Rotation.from_matrix(X1[:3, :3] @ X0[:3, :3].T).as_rotvec() / (2 * h)
        np.testing.assert_allclose(turn, V[:3], atol=1e-5)
        assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("name", CHANGES)
def test_before_the_fault_the_motion_is_the_same(name):
    for t in (0.0, 0.2, 0.5):
        for one, other in zip(
            altered(MOTION, CHANGES[name]).state(t), MOTION.state(t), strict=True
        ):
            np.testing.assert_array_equal(one, other)


def test_a_stopped_object_stays_and_goes_on_where_it_stopped():
    """A ramp takes half its length of path, at either end."""
    motion = altered(MOTION, [ObjectPace(start=1.0, duration=2.0, ramp=0.2)])
    np.testing.assert_allclose(motion.pose(1.5), MOTION.pose(1.1), atol=1e-12)
    np.testing.assert_allclose(motion.pose(2.9), MOTION.pose(1.1), atol=1e-12)
    np.testing.assert_allclose(motion.pose(7.0), MOTION.pose(5.0), atol=1e-12)


def test_a_reversed_object_goes_back_and_a_fast_one_five_times_as_far():
    back = altered(MOTION, [ObjectPace(start=1.0, factor=-1.0, ramp=0.2)])
    np.testing.assert_allclose(back.pose(2.0), MOTION.pose(2.0 - 2.0 * 0.9), atol=1e-12)
    fast = altered(MOTION, [ObjectPace(start=1.0, duration=1.0, factor=5.0, ramp=0.2)])
    np.testing.assert_allclose(fast.pose(3.0), MOTION.pose(3.0 + 4.0), atol=1e-12)


def test_a_pace_that_changes_again_and_again_adds_up():
    fault = ObjectPace(start=1.0, duration=0.5, every=2.0, factor=3.0, ramp=0.1)
    motion = altered(MOTION, [fault])
    for n in (1, 2, 50):
        t = 1.0 + 2.0 * n - 0.5
        np.testing.assert_allclose(motion.pose(t), MOTION.pose(t + 2.0 * 0.5 * n), atol=1e-9)


def test_a_moved_object_is_there_and_comes_back_in_the_same_orientation():
    motion = altered(MOTION, [ObjectMoved(start=1.0, duration=3.0, to=[1.3, 0.0, 0.2], ramp=1.0)])
    for t in (2.0, 3.0, 3.999):
        np.testing.assert_allclose(motion.pose(t)[:3, 3], [1.3, 0.0, 0.2], atol=1e-12)
        np.testing.assert_array_equal(motion.pose(t)[:3, :3], MOTION.pose(t)[:3, :3])
    np.testing.assert_allclose(motion.pose(5.0), MOTION.pose(5.0), atol=1e-12)


# --------------------------------------------------------------------------------------- command


def test_commands_that_are_not_numbers_or_absurd():
    assert np.isnan(CommandNan().command(np.zeros(7), rng())).all()
    draws = rng()
    wild = np.array([CommandWild().command(np.zeros(7), draws) for _ in range(50)])
    assert set(np.unique(wild)) == {-1e6, 1e6}
    assert (np.abs(wild.mean(axis=0)) < 6e5).all()
