"""SE(3): group axioms, and every closed form against SciPy or finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from feasigrasp.models.geometry import se3, se3_kernels

ANGLES = [0.0, 1e-12, 1e-8, 1e-4, 0.1, 0.785, 0.9999, 1.0001, 2.0, 3.0, np.pi - 1e-6, np.pi]
BEYOND_PI = [3.5, 5.0, 6.0]

twists = arrays(np.float64, 6, elements=st.floats(-1.7, 1.7))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def twist_of_angle(rng: np.random.Generator, angle: float, n: int = 50) -> np.ndarray:
    axis = rng.standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return np.concatenate([angle * axis, rng.uniform(-1, 1, (n, 3))], axis=1)


def algebra(v: np.ndarray) -> np.ndarray:
    """The 4x4 matrix of one twist, from the definition of the cross product."""
    out = np.zeros((4, 4))
    out[:3, :3] = np.cross(v[:3], np.eye(3)).T
    out[:3, 3] = v[3:]
    return out


@pytest.mark.parametrize("angle", ANGLES + BEYOND_PI)
def test_exp_is_the_matrix_exponential(rng, angle):
    v = twist_of_angle(rng, angle)
    expected = np.array([expm(algebra(x)) for x in v])
    np.testing.assert_allclose(se3.exp(v), expected, atol=1e-12)
    np.testing.assert_allclose(
        se3.so3_exp(v[:, :3]), Rotation.from_rotvec(v[:, :3]).as_matrix(), atol=1e-14
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_of_log_is_the_pose(rng, angle):
    X = se3.exp(twist_of_angle(rng, angle))
    v = se3.log(X)
    assert np.isfinite(v).all()
    np.testing.assert_allclose(se3.exp(v), X, atol=1e-14)
    np.testing.assert_allclose(se3.rotation_angle(X[:, :3, :3]), angle, atol=2e-15)
    np.testing.assert_allclose(se3.so3_log(X[:, :3, :3]), v[:, :3], atol=0)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a < 3.14])
def test_log_of_exp_is_the_twist(rng, angle):
    v = twist_of_angle(rng, angle)
    np.testing.assert_allclose(se3.log(se3.exp(v)), v, atol=1e-14)


@pytest.mark.parametrize("axis", [*np.eye(3), *(np.ones((3, 3)) - 2 * np.eye(3)) / np.sqrt(3)])
def test_log_at_exactly_half_a_turn(axis):
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    p = np.array([0.3, -0.2, 0.5])
    v = se3.log(se3.make_pose(R, p))
    np.testing.assert_allclose(np.abs(v[:3] @ axis), np.pi, rtol=1e-15)
    np.testing.assert_allclose(se3.exp(v), se3.make_pose(R, p), atol=1e-15)


def test_log_keeps_relative_accuracy_of_tiny_motions():
    v = np.array([1e-13, -2e-13, 3e-13, 4e-13, 5e-13, -6e-13])
    np.testing.assert_allclose(se3.log(se3.exp(v)), v, rtol=1e-12)


def test_so3_log_agrees_with_scipy(rng):
    R = Rotation.random(1000, rng).as_matrix()
    np.testing.assert_allclose(se3.so3_log(R), Rotation.from_matrix(R).as_rotvec(), atol=5e-14)


@given(twists, twists, twists)
@settings(max_examples=50, deadline=None)
def test_group_axioms(a, b, c):
    X, Y, Z = se3.exp(np.stack([a, b, c]))
    identity = np.eye(4)
    np.testing.assert_allclose(se3.inverse(X) @ X, identity, atol=1e-14)
    np.testing.assert_allclose(X @ se3.inverse(X), identity, atol=1e-14)
    np.testing.assert_allclose(se3.inverse(X @ Y), se3.inverse(Y) @ se3.inverse(X), atol=1e-13)
    np.testing.assert_allclose(se3.exp(-a), se3.inverse(X), atol=1e-13)
    # The distance that mixtures use is left-invariant.
    moved = se3.log(se3.inverse(Z @ X) @ (Z @ Y))
    np.testing.assert_allclose(se3.exp(moved), se3.exp(se3.log(se3.inverse(X) @ Y)), atol=1e-13)


@pytest.mark.parametrize("angle", ANGLES + BEYOND_PI)
def test_right_jacobian_inverse_against_finite_differences(rng, angle):
    h = 1e-6
    for v in twist_of_angle(rng, angle, 5):
        steps = h * np.eye(6)
        plus, minus = se3.exp(v + steps), se3.exp(v - steps)
        # exp(v - h)^-1 exp(v + h) is a small motion, so its log has no branch to worry about.
        right = se3.log(se3.inverse(minus) @ plus).T / (2 * h)
        np.testing.assert_allclose(se3.right_jacobian_inverse(v) @ right, np.eye(6), atol=1e-7)


@pytest.mark.parametrize("angle", ANGLES + BEYOND_PI)
def test_right_jacobian_inverse_against_its_power_series(rng, angle):
    for x in twist_of_angle(rng, angle, 10):
        ad = np.zeros((6, 6))
        ad[:3, :3] = ad[3:, 3:] = algebra(x)[:3, :3]
        ad[3:, :3] = se3.hat(x[3:])
        # J_r = integral of exp(-s ad) over s in [0, 1]: a block of one larger exponential.
        big = np.zeros((12, 12))
        big[:6, :6], big[:6, 6:] = -ad, np.eye(6)
        J = expm(big)[:6, 6:]
        np.testing.assert_allclose(J @ se3.right_jacobian_inverse(x), np.eye(6), atol=1e-11)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a < 3.1])
def test_right_jacobian_inverse_is_the_derivative_of_log(rng, angle):
    h = 1e-6
    for v in twist_of_angle(rng, angle, 5):
        X, steps = se3.exp(v), h * np.eye(6)
        numeric = (se3.log(X @ se3.exp(steps)) - se3.log(X @ se3.exp(-steps))).T / (2 * h)
        np.testing.assert_allclose(se3.right_jacobian_inverse(v), numeric, atol=1e-7)


def test_hat_is_the_cross_product(rng):
    a, b = rng.standard_normal((2, 20, 3))
    np.testing.assert_allclose((se3.hat(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)


def test_leading_axes_are_kept_and_kernels_agree(rng):
    v = rng.standard_normal((2, 3, 6))
    X = se3.exp(v)
    assert X.shape == (2, 3, 4, 4)
    assert se3.exp(np.zeros((0, 6))).shape == (0, 4, 4)
    for batched, kernel, argument in (
        (se3.exp, se3_kernels.exp_kernel, v),
        (se3.log, se3_kernels.log_kernel, X),
        (se3.inverse, se3_kernels.inverse_kernel, X),
        (se3.right_jacobian_inverse, se3_kernels.right_jacobian_inverse_kernel, v),
    ):
        assert batched(argument).shape[:2] == (2, 3)
        np.testing.assert_allclose(batched(argument)[1, 2], kernel(argument[1, 2]), atol=1e-15)


def test_any_memory_order_and_type():
    X = np.asfortranarray(se3.exp([0.1, 0.2, 0.3, 1, 2, 3]))
    np.testing.assert_allclose(se3.inverse(X) @ X, np.eye(4), atol=1e-15)
    assert se3.make_pose(np.eye(3, dtype=int), [1, 2, 3]).dtype == np.float64


def test_rotations_of_quaternions_agree_with_scipy(rng):
    q = rng.standard_normal((2, 50, 4))
    expected = Rotation.from_quat(q[..., [1, 2, 3, 0]].reshape(-1, 4)).as_matrix()
    np.testing.assert_allclose(se3.rotations(q), expected.reshape(2, 50, 3, 3), atol=1e-14)


def test_perpendiculars_make_right_handed_frames(rng):
    z = np.concatenate([rng.standard_normal((50, 3)), np.eye(3), -np.eye(3)])
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    R = np.stack([*se3.perpendiculars(z), z], axis=-1)
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.tile(np.eye(3), (56, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(np.stack([*se3.perpendiculars(z[7]), z[7]], axis=-1), R[7])


def test_make_pose_broadcasts(rng):
    p = rng.standard_normal((5, 3))
    X = se3.make_pose(np.eye(3), p)
    assert X.shape == (5, 4, 4)
    np.testing.assert_array_equal(X[:, :3, 3], p)
    np.testing.assert_array_equal(X[:, 3], np.tile([0, 0, 0, 1], (5, 1)))


def test_random_poses_are_uniform_rotations(rng):
    X = se3.random_pose(rng, 20_000)
    R = X[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)
    # Haar measure: the angle has density (1 - cos t) / pi, so its mean is pi / 2 + 2 / pi.
    assert abs(se3.rotation_angle(R).mean() - (np.pi / 2 + 2 / np.pi)) < 0.02
    assert np.abs(R.mean(axis=0)).max() < 0.02
    assert np.abs(X[:, :3, 3]).max() <= 1.0


def test_extrapolation_turns_about_the_moving_origin(rng):
    X, V = se3.random_pose(rng, 1)[0], rng.standard_normal(6)
    moved = se3.extrapolate(X, V, 0.7)
    turn = Rotation.from_rotvec(0.7 * V[:3]).as_matrix()
    np.testing.assert_allclose(moved, se3.make_pose(turn @ X[:3, :3], X[:3, 3] + 0.7 * V[3:]))
    h = 1e-6
    spin = se3.so3_log(se3.extrapolate(X, V, h)[:3, :3] @ X[:3, :3].T) / h
    np.testing.assert_allclose(spin, V[:3], atol=1e-8)


def test_interpolation_is_a_motion_at_one_twist(rng):
    X, V = se3.random_pose(rng, 1)[0], twist_of_angle(rng, 2.0)[0]
    end = X @ expm(algebra(V))
    for share in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(
            se3.interpolate(X, end, share), X @ expm(share * algebra(V)), atol=1e-12
        )


def test_nan_stays_nan_and_raises_nothing():
    X = np.eye(4)
    X[0, 0] = np.nan
    assert np.isnan(se3.log(X)).any()
    assert np.isnan(se3.exp(np.full(6, np.nan))).any()


@pytest.mark.parametrize(
    ("function", "shape"), [(se3.exp, (5,)), (se3.log, (3, 4)), (se3.hat, (2, 4)), (se3.exp, ())]
)
def test_wrong_shapes_are_named(function, shape):
    with pytest.raises(ValueError, match="give numbers of shape"):
        function(np.zeros(shape))
