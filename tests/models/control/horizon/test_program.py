"""The program against limits and against its own objective, written out."""

import numpy as np
import pytest

from feasigrasp.errors import ControlError
from feasigrasp.models.control.horizon.knots import Form
from feasigrasp.models.control.horizon.program import ProgramOptions, positions, solve_program
from feasigrasp.models.robot.iiwa import IIWA_7

OPTIONS = ProgramOptions()
N = len(OPTIONS.steps)
Q = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1])


def problem(target, v_ref=0.0):
    """Squared distances of the positions to a target, about a plan at rest."""
    v = np.zeros((N + 1, 7))
    H = np.tile(1000.0 * np.eye(7), (N, 1, 1))
    return v, H, 1000.0 * (positions(Q, v, OPTIONS) - target), np.full((N, 7), v_ref)


def objective(v, H, g, v_ref):
    """The sum of the module's docstring; a constant reference has no acceleration."""
    dq, h = positions(Q, v, OPTIONS) - Q, OPTIONS.h
    share = h + OPTIONS.terminal * (np.arange(N) == N - 1)
    total = np.einsum("k,ki,kij,kj->", 0.5 * share, dq, H, dq) + np.einsum(
        "k,ki,ki->", share, g, dq
    )
    total += 0.5 * OPTIONS.velocity * np.einsum("k,ki->", share, (v[1:] - v_ref) ** 2)
    slope = np.diff(v, axis=0) / h[:, None]
    return total + 0.5 * OPTIONS.acceleration * np.einsum("k,ki->", h, slope**2)


def test_without_active_limits_no_other_plan_is_better():
    v, H, g, v_ref = problem(Q + 0.005, 0.002)
    found = solve_program(Q, v, Form(H, g, v_ref), OPTIONS)
    best, rng = objective(found, H, g, v_ref), np.random.default_rng(0)
    assert best < objective(v, H, g, v_ref)
    for size in (1e-4, 1e-3, 1e-2):
        for _ in range(10):
            other = found.copy()
            other[1:] += size * rng.standard_normal((N, 7))
            assert objective(other, H, g, v_ref) > best


def test_one_step_is_no_plan():
    with pytest.raises(ControlError, match=r"steps = \(0.02,\); give at least two"):
        ProgramOptions(steps=(0.02,))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_far_target_is_gone_for_at_the_limits_and_not_beyond(sign):
    v, H, g, v_ref = problem(Q + sign * 2.0)
    found = solve_program(Q, v, Form(H, g, v_ref), OPTIONS)
    velocity = np.abs(found) / OPTIONS.most_v
    acceleration = np.abs(np.diff(found, axis=0)) / (OPTIONS.h[:, None] * OPTIONS.most_a)
    assert velocity.max() <= 1.0 + 1e-6
    assert acceleration.max() == pytest.approx(1.0, abs=1e-6)
    assert (sign * found[-1] >= -1e-6).all()


def test_a_position_limit_is_approached_as_the_safety_filter_does():
    q = IIWA_7.upper - 0.1
    v = np.zeros((N + 1, 7))
    H = np.tile(1000.0 * np.eye(7), (N, 1, 1))
    g = 1000.0 * (positions(q, v, OPTIONS) - (q + 1.0))
    found = solve_program(q, v, Form(H, g, np.zeros((N, 7))), OPTIONS)
    left = IIWA_7.upper - OPTIONS.safety.position_margin - positions(q, found, OPTIONS)
    assert left.min() > -1e-3
    assert (found[1:] - OPTIONS.safety.approach_gain * left).max() < 0.02
