"""Exact intervals of arm angle against a dense scan of the closed form."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.redundancy import make_segments, segments_kernel
from feasigrasp.models.ik.self_motion import arm_angle, closed_form, self_motion_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics


def random_configurations(n, seed=0, share=1.0):
    limits = share * IIWA_7.upper
    return np.random.default_rng(seed).uniform(-limits, limits, (n, 7))


def joined(start, inside):
    """Intervals from segments: ``start`` has one entry more than ``inside``."""
    if inside.all():
        return [(-np.pi, np.pi)]
    count = len(inside)
    offset = int(np.flatnonzero(~inside)[0])  # no interval runs across the start of this segment
    intervals = []
    for step in range(count):
        k = (offset + step) % count
        turn = 2 * np.pi if offset + step >= count else 0.0
        low, high = float(start[k]) + turn, float(start[k + 1]) + turn
        if not inside[k]:
            continue
        if intervals and inside[k - 1]:
            intervals[-1] = (intervals[-1][0], high)
        else:
            intervals.append((low, high))
    return intervals


def arm_angle_intervals(X_WF, margin=0.0):
    """For each branch its closed intervals of arm angle, shape (k, 2) [rad], ascending.

    An interval starts in [-pi, pi) and may end beyond pi; (-pi, pi) is the whole circle.
    """
    segments = make_segments(IIWA_7.chain, float(margin))
    count = segments_kernel(
        self_motion_kernel(IIWA_7.chain, np.ascontiguousarray(X_WF, dtype=float)), segments
    )
    found = []
    for branch in range(8):
        inside = (segments.branches[:count] >> branch) & 1 == 1
        if not inside.any():
            found.append(np.zeros((0, 2)))
            continue
        intervals = np.array(joined(segments.start[: count + 1], inside))
        if not inside.all():  # from elbow angles to arm angles
            intervals -= np.pi if branch >= 4 else 0.0
            low = (intervals[:, :1] + np.pi) % (2 * np.pi) - np.pi
            intervals += low - intervals[:, :1]
        found.append(intervals[np.argsort(intervals[:, 0])])
    return found


def contains(intervals, psi):
    turned = psi + 2 * np.pi
    low, high = intervals[:, 0], intervals[:, 1]
    return bool((((low <= psi) & (psi <= high)) | ((low <= turned) & (turned <= high))).any())


def scan(X, margin, psis):
    """How far every branch is inside the limits, shape (len(psis), 8) [rad]."""
    return np.array(
        [(IIWA_7.upper - margin - np.abs(closed_form(X, psi))).min(axis=1) for psi in psis]
    )


@pytest.mark.parametrize("margin", [0.0, 0.05, 0.4])
def test_intervals_are_where_a_dense_scan_is_inside(margin):
    psis = np.linspace(-np.pi, np.pi, 360, endpoint=False) + 1e-3
    seen = np.zeros(2, dtype=int)
    for X in forward_kinematics(random_configurations(60, seed=1)):
        intervals, slack = arm_angle_intervals(X, margin), scan(X, margin, psis)
        for branch in range(8):
            inside = [contains(intervals[branch], psi) for psi in psis]
            np.testing.assert_array_equal(inside, slack[:, branch] >= 0.0)
            seen += [sum(inside), len(inside) - sum(inside)]
    assert seen.min() > 1000


def test_at_their_ends_a_joint_is_at_its_limit():
    margin, ends = 0.05, 0
    for X in forward_kinematics(random_configurations(60, seed=2)):
        for branch, intervals in enumerate(arm_angle_intervals(X, margin)):
            assert (intervals[:, 0] >= -np.pi).all() and (intervals[:, 0] < np.pi).all()
            assert (intervals[:, 1] > intervals[:, 0]).all()
            assert (intervals[1:, 0] > intervals[:-1, 1]).all()
            for psi in intervals[intervals[:, 1] - intervals[:, 0] < 2 * np.pi - 1e-9].ravel():
                slack = scan(X, margin, [psi])[0, branch]
                # At a singularity a joint jumps past its limit instead of coming to it.
                beyond = scan(X, margin, [psi - 1e-6, psi + 1e-6])[:, branch]
                assert abs(slack) < 1e-7 or beyond.min() < 0.0
                ends += abs(slack) < 1e-7
    assert ends > 200


def test_windows_too_narrow_for_a_grid_are_found():
    """Configurations a hair inside two limits at once: their windows are a few milliradian."""
    rng = np.random.default_rng(3)
    narrow = 0
    for q in random_configurations(3000, seed=3, share=0.95):
        joints = rng.choice(7, 3, replace=False)
        q[joints] = np.sign(q[joints]) * (IIWA_7.upper[joints] - 1e-4)
        X = forward_kinematics(q)
        intervals = arm_angle_intervals(X)
        assert any(contains(found, arm_angle(q)) for found in intervals)
        total = sum(float((found[:, 1] - found[:, 0]).sum()) for found in intervals)
        if total < 0.02:
            narrow += 1
            coarse = np.linspace(-np.pi, np.pi, 24, endpoint=False)
            assert (scan(X, 0.0, coarse) >= 0.0).sum() <= 1
    assert narrow > 5


def test_a_straight_elbow_leaves_the_arm_angle_free():
    q = np.array([0.3, 0.5, 0.2, 0.0, 0.4, 0.6, -0.5])
    X = forward_kinematics(q)
    intervals, psis = arm_angle_intervals(X), np.linspace(-3.1, 3.1, 100)
    slack = scan(X, 0.0, psis)
    for branch in range(8):
        expected = slack[:, branch] >= 0.0
        assert [contains(intervals[branch], psi) for psi in psis] == expected.tolist()
    assert sum(len(found) for found in intervals) > 0


def test_no_intervals_out_of_reach():
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.0])
    folded = forward_kinematics(np.array([0.0, 0.5, 0.0, np.deg2rad(125), 0.0, 0.5, 0.0]))
    for X in (far, folded, np.full((4, 4), np.nan)):
        assert [found.shape for found in arm_angle_intervals(X)] == [(0, 2)] * 8


def test_a_whole_circle():
    """There is none inside the limits, as joint 1 or 3 and joint 5 or 7 turn once: but without."""
    for X in forward_kinematics(random_configurations(20, seed=4)):
        assert all(
            (np.ptp(found, axis=1) < 2 * np.pi - 0.1).all() for found in arm_angle_intervals(X)
        )
        for found in arm_angle_intervals(X, margin=-2.0):
            np.testing.assert_array_equal(found, [[-np.pi, np.pi]])
