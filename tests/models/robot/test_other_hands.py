"""Hands of any size and camera mount keep the clearance to the arm's own links."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.capsules import body_pairs_of, hand_capsules
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.robot.iiwa import IIWA_7

OPTIONS = SafetyOptions()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 60.0, 0.0])


def a_hand(seed):
    rng = np.random.default_rng(seed)
    return ParallelGripper(
        palm_size=rng.uniform([0.08, 0.06, 0.05], [0.2, 0.2, 0.08]),
        camera_center=(0.0, rng.uniform(0.06, 0.18), rng.uniform(-0.16, -0.1)),
        max_opening=rng.uniform(0.06, 0.15),
    )


def segments(hand):
    """Samples of the capsules of links 0 to 5 and of the hand: link, point and radius each."""
    arm = [c for c in IIWA_7.capsules if c.body <= 5]
    share = np.linspace(0.0, 1.0, 9)[:, None]
    for capsules in (arm, hand_capsules(hand)):
        yield (
            np.repeat([min(c.body, IIWA_7.joints) for c in capsules], 9),
            np.concatenate([(1 - share) * c.a + share * np.array(c.b) for c in capsules]),
            np.repeat([c.radius for c in capsules], 9),
        )


def distance(q, arm, hand):
    """Least distance of the samples [m]; at most 5 mm more than that of the capsules."""
    R, origin = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(IIWA_7.chain, q, R, origin)
    at = [np.einsum("kij,kj->ki", R[k], p) + origin[k] for k, p, _ in (arm, hand)]
    apart = np.linalg.norm(at[0][:, None] - at[1][None], axis=2)
    return (apart - arm[2][:, None] - hand[2][None]).min()


@pytest.mark.parametrize("seed", range(24))
def test_a_request_to_run_into_the_arm_ends_at_the_clearance(seed):
    """Down the gradient of the distance, from home and at either end of joint 7."""
    hand = a_hand(seed)
    arm, tool = segments(hand)
    safety, q, v = SafetyFilter(OPTIONS, hand), HOME.copy(), np.zeros(7)
    q[6] = (-2.5, 0.0, 2.5)[seed % 3]
    least, request = np.inf, np.zeros(7)
    for k in range(400):
        if k % 10 == 0:
            d = distance(q, arm, tool)
            slope = [distance(q + 1e-4 * e, arm, tool) - d for e in np.eye(7)]
            request = -3.0 * np.sign(slope) * (np.abs(slope) > 1e-7)
            least = min(least, d)
        v = safety.velocity(q, request, qd_last=v)
        q = q + OPTIONS.period * v
    assert least >= OPTIONS.clearance - 3e-4
    assert least < 0.15  # it was tried


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("name, seed", [("WSG_50", 0), ("EZGripper", 0), ("any", 3), ("any", 5)])
def test_the_wrist_at_its_limit_keeps_the_clearance(name, seed, side):
    hand = a_hand(seed) if name == "any" else load_gripper(name)
    arm, tool = segments(hand)
    for q7 in np.linspace(-2.9, 2.9, 7):
        safety, q, v = SafetyFilter(OPTIONS, hand), HOME.copy(), np.zeros(7)
        q[6] = q7
        for _ in range(300):
            v = safety.velocity(q, 3.0 * side * np.eye(7)[5], qd_last=v)
            q = q + OPTIONS.period * v
        guarded = name != "EZGripper"  # of the default hand by the visible bodies, see above
        assert distance(q, arm, tool) >= (OPTIONS.clearance - 3e-4 if guarded else 0.0)


def test_a_capsule_holds_the_box_of_a_camera_that_is_deeper_than_high():
    hand = replace(ParallelGripper(), camera_box=(0.09, 0.025, 0.10))
    a, b = np.array(hand_capsules(hand)[-1][1:3])
    half = np.array(hand.camera_box) / 2
    corners = hand.camera_center + half * (np.indices((2, 2, 2)).reshape(3, -1).T * 2 - 1)
    X_LG = IIWA_7.X_LF @ hand.X_FG
    corners = corners @ X_LG[:3, :3].T + X_LG[:3, 3]
    t = np.clip((corners - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    away = np.linalg.norm(corners - a - t[:, None] * (b - a), axis=1)
    assert away.max() <= hand_capsules(hand)[-1].radius + 1e-9


def test_other_hands_are_kept_off_every_link_but_those_that_carry_them():
    default, other = set(body_pairs_of()), set(body_pairs_of(a_hand(0)))
    assert default == set(body_pairs_of(ParallelGripper())) < other
    assert {low for low, high in other if high > IIWA_7.joints} == {0, 1, 2, 3, 4, 5}
