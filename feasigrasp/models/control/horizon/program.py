"""Quadratic program over the joint velocities of the next second.

Unknowns are the joint velocities at N knots, linear in between, ``q_k = q_0 + sum_a c_ka v_a`` with
the trapezoidal rule c. About a plan (real-time iteration, Diehl et al., "A real-time iteration
scheme for nonlinear optimization in optimal feedback control", SICON 2005) it solves::

    min   sum_k s_k (1/2 dq_k' H_k dq_k + g_k' dq_k + w_v/2 |v_k - v_ref,k|^2)
          + h_k w_a/2 |(v_k - v_(k-1)) / h_k - a_ref,k|^2
    s.t.  |v_k| <= V,   |v_k - v_(k-1)| <= A h_k,
          v_k <= g (q_max - q_k),   -v_k <= g (q_k - q_min)

with the limits V, A and the gain g of the safety filter. Velocities and accelerations are penalised
*relative* to the reference: a penalty on accelerations as such costs (w / w_n)^4 of the amplitude
of a motion at frequency w.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, record
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.knots import Form
from feasigrasp.models.control.safety.safe_velocity import SOFT, SafetyOptions
from feasigrasp.models.quantities import NotNegative, Positive


@dataclass(frozen=True)
class ProgramOptions:
    """Knots and weights of the program; a weight is 1 over the square of the error that counts 1.

    Attributes:
        steps: Between the knots [s]; the first is the period of the plans. 12 of them are the
            prototype's choice: 84 unknowns, 0.4 ms.
        tail: Exponent nu of the density of grasps.
        tail_position: Position error at which the density has halved in weight, so that far away
            the joints lead [m]; sqrt(2 nu) times smaller, at 3 mm, the error counts 1: half the
            tolerance of closing. It and the next were chosen among two values on the circle at
            0.6 m/s.
        tail_angle: Angle error, likewise [rad]: it counts 1 at 0.022 rad.
        worth: What a second of a grasp's cost is worth in its log density [1/s]; guessed.
        distance: Weight of the distance field [1/rad^2]: 1 at 5 mrad; guessed.
        speed: What a second of a grasp's cost is worth in the distance field [rad/s]; guessed.
        clearance: Weight of the object's clearance at each point of the hand [1/m^2]: 1 at 7 mm;
            guessed.
        joint: Of the joints' distance to the reference [1/rad^2]: 1 at 0.045 rad; guessed, as all
            below.
        velocity: Of the joint velocity relative to the reference's [s^2/rad^2].
        acceleration: Of the joint acceleration relative to the reference's [s^4/rad^2].
        terminal: The last knot counts as this much time more [s].
        near: A reference this close to the joints is followed at once, not intercepted [rad].
        safety: Limits, those of the safety filter.
    """

    steps: tuple[Positive, ...] = (
        *(0.02, 0.03, 0.04, 0.05, 0.06, 0.07),
        *(0.08, 0.09, 0.1, 0.12, 0.14, 0.16),
    )
    tail: Positive = 1000.0
    tail_position: Positive = 0.15
    tail_angle: Positive = 1.0
    worth: NotNegative = 20.0
    distance: NotNegative = 4e4
    speed: NotNegative = 1.0
    clearance: NotNegative = 2e4
    joint: NotNegative = 500.0
    velocity: NotNegative = 2.0
    acceleration: Positive = 0.3
    terminal: NotNegative = 0.3
    near: NotNegative = 0.3
    safety: SafetyOptions = field(default_factory=SafetyOptions)

    def __post_init__(self) -> None:
        """Raises ControlError for a wrong number, or less than two steps."""
        check_fields(self, ControlError)
        if len(self.steps) < 2:
            raise ControlError(f"ProgramOptions.steps = {self.steps}; give at least two steps")

    @cached_property
    def h(self) -> Array:
        """Between the knots, shape (N,) [s]."""
        return np.array(self.steps)

    @cached_property
    def times(self) -> Array:
        """Times of all knots from now on, shape (N + 1,) [s]."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    @cached_property
    def most_v(self) -> Array:
        """Velocity limits, shape (7,) [rad/s]."""
        share = self.safety.speed * self.safety.velocity_scale
        return np.asarray(share * self.safety.arm.velocity_limits)

    @cached_property
    def most_a(self) -> Array:
        """Acceleration limits, shape (7,) [rad/s^2]."""
        limits = self.safety.arm.acceleration_limits
        return np.asarray(self.safety.acceleration_scale * limits)

    @cached_property
    def trapezoid(self) -> Array:
        """Coefficients c of the positions at the knots, shape (N, N) [s]."""
        h, n = self.h, len(self.h)
        c = np.tril(np.tile(0.5 * (h + np.append(h[1:], 0.0)), (n, 1)), -1)
        c[np.diag_indices(n)] = 0.5 * h
        return c

    @cached_property
    def record(self) -> NDArray[np.void]:
        """The weights for kernels."""
        return record(self)


def positions(q: Array, v: Array, options: ProgramOptions) -> Array:
    """Positions (N, 7) [rad] at the knots after now, for velocities (N + 1, 7) [rad/s]."""
    return np.asarray(q + np.cumsum(0.5 * options.h[:, None] * (v[:-1] + v[1:]), axis=0))


class _Steps(NamedTuple):
    """Times between the knots h [s], coefficients c, and the time that each counts, shape (N,)."""

    h: Array
    c: Array
    share: Array


class _Limits(NamedTuple):
    """Limits of position, velocity and acceleration, shape (n,), and gains of the safety filter."""

    least_q: Array
    most_q: Array
    v: Array
    a: Array
    approach_gain: float
    speed_gain: float


def solve_program(q: Array, v: Array, form: Form, options: ProgramOptions) -> Array | None:
    """Velocities (N + 1, 7) [rad/s] of the plan; None without a solution.

    The joints are at ``q`` (7,) [rad] now. The cost is quadratic about a plan with the velocities
    ``v`` (N + 1, 7) [rad/s], the first those of the arm.
    """
    h, safety = options.h, options.safety
    share = h.copy()
    share[-1] += options.terminal
    steps = _Steps(h, options.trapezoid, share)
    least_q = safety.arm.lower + safety.position_margin
    most_q = safety.arm.upper - safety.position_margin
    gains = safety.approach_gain, safety.speed_gain
    limits = _Limits(least_q, most_q, options.most_v, options.most_a, *gains)
    at = positions(q, v, options)
    # A position limit has rows only where it is this near [rad]; guessed.
    near = (at > most_q - 0.7) | (at < least_q + 0.7)
    n, m = near.size, int(near.sum())
    big, f, rows = np.zeros((n, n)), np.zeros(n), np.zeros((n - len(q) + m, n))
    lower, upper = np.empty(n + len(rows)), np.empty(n + len(rows))
    _objective_kernel(v, steps, form, limits.a, (options.velocity, options.acceleration), big, f)
    _limits_kernel(q, v, steps, limits, near, rows, lower, upper)
    senses = np.zeros(len(upper), dtype=np.intc)
    senses[len(upper) - m :] = SOFT
    step, _, status, _ = daqp.solve(big, f, rows, upper, lower, senses)
    if status <= 0 or not np.isfinite(step).all():
        return None
    return np.concatenate([v[:1], v[1:] + step.reshape(-1, len(q))])


@compiled
def _objective_kernel(v, steps, form, most_a, weights, big, f):
    """Writes Hessian (7 N, 7 N) and gradient (7 N,) in the changes of the velocities v (N + 1, 7).

    ``weights`` are those of velocity and acceleration relative to the reference's.
    """
    h, c, share = steps
    w_v, w_a = weights
    n, joints = form.g.shape
    for k in range(n):
        for a in range(k + 1):
            weight = share[k] * c[k, a]
            for i in range(joints):
                f[a * joints + i] += weight * form.g[k, i]
            for b in range(k + 1):
                both = weight * c[k, b]
                for i in range(joints):
                    for j in range(joints):
                        big[a * joints + i, b * joints + j] += both * form.H[k, i, j]
    for k in range(n):
        for i in range(joints):
            x, later = k * joints + i, max(k, 1)
            change = form.v_ref[later, i] - form.v_ref[later - 1, i]
            a_ref = min(max(change / h[later], -most_a[i]), most_a[i])
            slope = (v[k + 1, i] - v[k, i]) / h[k] - a_ref
            big[x, x] += share[k] * w_v + w_a / h[k]
            f[x] += share[k] * w_v * (v[k + 1, i] - form.v_ref[k, i]) + w_a * slope
            if k > 0:
                big[x - joints, x - joints] += w_a / h[k]
                big[x, x - joints] -= w_a / h[k]
                big[x - joints, x] -= w_a / h[k]
                f[x - joints] -= w_a * slope


@compiled
def _limits_kernel(q, v, steps, limits, near, rows, lower, upper):
    """Writes bounds and rows in the changes of the velocities v (N + 1, 7).

    There are 7 N simple bounds, rows of accelerations, and rows of positions that are ``near``
    (N, 7) a limit.
    """
    h, c, _ = steps
    (n, joints), most_v = near.shape, limits.v
    for k in range(n):
        for i in range(joints):
            x, change, most = k * joints + i, v[k + 1, i] - v[k, i], limits.a[i] * h[k]
            upper[x], lower[x] = most_v[i] - v[k + 1, i], -most_v[i] - v[k + 1, i]
            if k > 0:
                rows[x - joints, x], rows[x - joints, x - joints] = 1.0, -1.0
                upper[joints * (n - 1) + x], lower[joints * (n - 1) + x] = (
                    most - change,
                    -most - change,
                )
                continue
            # the first step as the safety filter has it
            reserve = limits.speed_gain * h[0]
            faster = min(most, max(reserve * (most_v[i] - v[0, i]), -v[0, i], 0.0))
            slower = min(most, max(reserve * (most_v[i] + v[0, i]), v[0, i], 0.0))
            upper[i] = max(min(upper[i], faster - change), -most - change)
            lower[i] = min(max(lower[i], -slower - change), most - change)
    r, position, gain = joints * (n - 1), q.copy(), limits.approach_gain
    for k in range(n):
        for i in range(joints):
            position[i] += 0.5 * h[k] * (v[k, i] + v[k + 1, i])
            if near[k, i]:
                for a in range(k + 1):
                    rows[r, a * joints + i] = gain * c[k, a]
                rows[r, k * joints + i] += 1.0
                at = v[k + 1, i] + gain * position[i]
                upper[joints * n + r] = gain * limits.most_q[i] - at
                lower[joints * n + r] = gain * limits.least_q[i] - at
                r += 1
