"""The carrying wrench in closed loop with a free rigid body, integrated by SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.spring_drive import (
    SPRINGS,
    Compliance,
    DrivenBody,
    carried_body,
    drive_wrench_kernel,
    motion_wrench_kernel,
    rotation_kernel,
)

GRAVITY = np.array([0.0, 0.0, -9.81])
MASS = 0.4
INERTIA = np.array([[6e-4, 1e-4, -5e-5], [1e-4, 9e-4, 2e-5], [-5e-5, 2e-5, 4e-4]])
FREQUENCY = 20.0


def rotation(wxyz):
    R = np.empty((3, 3))
    rotation_kernel(np.asarray(wxyz, dtype=float), R)
    return R


def critically_damped(gravity=GRAVITY, max_force=np.inf, max_torque=np.inf):
    """On springs whose stiffness and damping are mass and inertia times w^2 and 2 w."""
    w = FREQUENCY
    spring = MASS * w**2, 2.0 * MASS * w, INERTIA * w**2, 2.0 * INERTIA * w
    return DrivenBody(MASS, INERTIA, gravity, *spring, max_force, max_torque)


def wrench_at(state, X_WR, V_WR, acceleration, load=None):
    wrench = np.empty(6)
    load = critically_damped() if load is None else load
    drive_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench)
    return wrench


def carried(state, reference, duration, times=None):
    """States of a free body under gravity and the wrench, by the Newton-Euler equations."""

    def derivative(t, state):
        wxyz, omega = state[:4], state[7:10]
        wrench = wrench_at(state, *reference(t))
        R = rotation(wxyz)
        I_W = R @ INERTIA @ R.T
        w, v = wxyz[0], wxyz[1:]
        quaternion = 0.5 * np.concatenate([[-omega @ v], w * omega + np.cross(omega, v)])
        spin = np.linalg.solve(I_W, wrench[:3] - np.cross(omega, I_W @ omega))
        return np.concatenate([quaternion, state[10:], spin, wrench[3:] / MASS + GRAVITY])

    solution = solve_ivp(
        derivative, (0.0, duration), state, t_eval=times, rtol=1e-9, atol=1e-11, method="DOP853"
    )
    return solution.y.T


def at_rest(p=(0.0, 0.0, 0.0), wxyz=(1.0, 0.0, 0.0, 0.0)):
    return np.array([*wxyz, *p, *np.zeros(6)])


def still(t):
    return np.eye(4), np.zeros(6), np.zeros(3)


def turning_and_swinging(t):
    m = HarmonicMotion(
        center=np.array([0.5, 0.0, 0.5]),
        amplitude=np.array([0.1, 0.2, 0.05]),
        harmonic=np.array([1.0, 2.0, 1.0]),
        offset_deg=np.array([90.0, 0.0, 0.0]),
        rate=2.0,
        start_phase=0.0,
        spin_axis=np.array([1.0, 1.0, -0.5]),
        spin=1.5,
    )
    return m.state(t)


def test_rotation_of_a_quaternion():
    rng = np.random.default_rng(0)
    for _ in range(20):
        axis, angle = rng.standard_normal(3), rng.uniform(-3, 3)
        axis /= np.linalg.norm(axis)
        wxyz = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
        for scale in (1.0, -1.0, 3.7):
            np.testing.assert_allclose(
                rotation(scale * wxyz), se3.so3_exp(angle * axis), atol=1e-12
            )


def test_it_bears_the_weight_and_nothing_else_at_the_reference():
    np.testing.assert_allclose(
        wrench_at(at_rest(), *still(0.0)), [0, 0, 0, 0, 0, 9.81 * MASS], atol=1e-12
    )
    weightless = critically_damped(np.zeros(3))
    np.testing.assert_allclose(wrench_at(at_rest(), *still(0.0), weightless), 0, atol=1e-12)


def test_a_position_error_decays_critically_damped():
    """e(t) = (e0 + (de0 + w e0) t) exp(-w t), per axis."""
    times = np.linspace(0.0, 0.6, 25)
    offset, speed = np.array([0.03, -0.02, 0.05]), np.array([0.2, 0.1, -0.4])
    start = at_rest(offset)
    start[10:] = speed
    error = carried(start, still, 0.6, times)[:, 4:7]
    t = times[:, None]
    expected = (offset + (speed + FREQUENCY * offset) * t) * np.exp(-FREQUENCY * t)
    np.testing.assert_allclose(error, expected, atol=1e-8)


def test_an_angle_error_decays_critically_damped():
    """About one axis the angle obeys the same law, whatever the inertia couples."""
    times = np.linspace(0.0, 0.6, 25)
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, 2.5
    start = at_rest(wxyz=[np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    states = carried(start, still, 0.6, times)
    expected = angle * (1 + FREQUENCY * times) * np.exp(-FREQUENCY * times)
    for state, theta in zip(states, expected, strict=True):
        np.testing.assert_allclose(se3.so3_log(rotation(state[:4])), theta * axis, atol=1e-7)


def test_it_follows_a_moving_reference_without_lag():
    X, V, _ = turning_and_swinging(0.0)
    on_track = np.concatenate([[1, 0, 0, 0], X[:3, 3], V])
    state = carried(on_track, turning_and_swinging, 1.0)[-1]
    X_end, V_end, _ = turning_and_swinging(1.0)
    np.testing.assert_allclose(state[4:7], X_end[:3, 3], atol=1e-7)
    np.testing.assert_allclose(rotation(state[:4]), X_end[:3, :3], atol=1e-6)
    np.testing.assert_allclose(state[7:], V_end, atol=1e-5)


def test_it_catches_up_with_a_moving_reference():
    state = carried(at_rest([0.6, -0.1, 0.4]), turning_and_swinging, 1.5)[-1]
    X_end, V_end, _ = turning_and_swinging(1.5)
    np.testing.assert_allclose(state[4:7], X_end[:3, 3], atol=1e-6)
    np.testing.assert_allclose(rotation(state[:4]), X_end[:3, :3], atol=1e-5)
    np.testing.assert_allclose(state[7:], V_end, atol=1e-4)


def test_the_torque_carries_a_free_spin():
    """At the reference attitude and rate, what is left is the gyroscopic torque w x I w."""
    omega = np.array([1.0, -2.0, 3.0])
    state = at_rest()
    state[7:10] = omega
    V = np.concatenate([omega, np.zeros(3)])
    wrench = wrench_at(state, np.eye(4), V, np.zeros(3))
    np.testing.assert_allclose(wrench[:3], np.cross(omega, INERTIA @ omega), atol=1e-12)


@pytest.mark.parametrize("compliance", Compliance)
def test_an_object_yields_by_the_stiffness_of_its_carrier(compliance):
    """Along and about any axis, whatever its mass, if the time step is short."""
    spring, axis, by = SPRINGS[compliance], np.array([2.0, -1.0, 2.0]) / 3, 0.01
    moved = at_rest(by * axis, [np.cos(by / 2), *(np.sin(by / 2) * axis)])
    for scale in (1.0, 10.0):
        body = carried_body(scale * MASS, scale * INERTIA, np.zeros(3), spring, 1e-4)
        expected = [-spring.angular_stiffness * by * axis, -spring.stiffness * by * axis]
        wrench = wrench_at(moved, *still(0.0), body)
        np.testing.assert_allclose(wrench, np.concatenate(expected), rtol=1e-9, atol=1e-9)


def test_a_spring_too_stiff_for_the_time_step_is_as_soft_as_it_must_be():
    """By the spectral radius of a step of semi-implicit Euler, along and about principal axes."""
    spring, dt, scale = SPRINGS[Compliance.RIGID], 0.0025, 0.05

    def radius(k, c, m):
        v = [-dt * k / m, 1.0 - dt * c / m]  # v' by x and v; x' = x + dt v'
        return np.abs(np.linalg.eigvals([[1.0 + dt * v[0], dt * v[1]], v])).max()

    body = carried_body(scale * MASS, scale * INERTIA, np.zeros(3), spring, dt)
    inertia, axes = np.linalg.eigh(scale * INERTIA)
    turning, damping = (np.diag(axes.T @ each @ axes) for each in (body.K_B, body.D_B))
    springs = [(body.stiffness, body.damping, body.mass, spring.stiffness)]
    springs += [
        (*each, spring.angular_stiffness) for each in zip(turning, damping, inertia, strict=True)
    ]
    for k, c, m, wanted in springs:
        assert k < wanted and radius(k, c, m) < 0.99
        assert radius(wanted, c * np.sqrt(wanted / k), m) > 1.0


def test_beyond_its_strength_the_spring_gives_way():
    m = HarmonicMotion(
        np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3), 1.0, 0.0, np.array([0.0, 0.0, 1.0]), 0.0
    )
    far = np.array([np.cos(0.5), np.sin(0.5), 0, 0, 0.4, -0.3, 0.0, *np.zeros(6)])
    wrench = np.empty(6)

    def pull(max_force, max_torque):
        load = critically_damped(GRAVITY, max_force, max_torque)
        motion_wrench_kernel(far, m.parameters, 0.0, load, wrench)
        return wrench[:3].copy(), wrench[3:] + MASS * GRAVITY

    free_torque, free_force = pull(1e9, 1e9)
    torque, force = pull(20.0, 0.1)
    assert np.linalg.norm(free_force) > 20.0 and np.linalg.norm(free_torque) > 0.1
    assert np.linalg.norm(force) == pytest.approx(20.0)
    assert np.linalg.norm(torque) == pytest.approx(0.1)
    np.testing.assert_allclose(np.cross(force, free_force), 0, atol=1e-9)
    np.testing.assert_allclose(np.cross(torque, free_torque), 0, atol=1e-9)
