"""Motions of the object against finite differences and the paper's formulas."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.motion import HarmonicMotion

TIMES = np.linspace(0.0, 21.0, 40)


def motion(**changes):
    values = {
        "center": np.array([0.5, -0.1, 0.4]),
        "amplitude": np.array([0.1, 0.2, 0.05]),
        "harmonic": np.array([1.0, 2.0, 3.5]),
        "offset_deg": np.array([90.0, 20.0, -70.0]),
        "rate": 0.6,
        "start_phase": 0.4,
        "spin_axis": np.array([1.0, -2.0, 0.5]),
        "spin": 0.7,
        "R_WO": se3.so3_exp([0.3, 0.9, -1.4]),
    }
    return HarmonicMotion(**{**values, **changes})


def test_velocity_by_finite_differences():
    m, h = motion(), 1e-5
    for t in TIMES:
        before, after = m.pose(t - h), m.pose(t + h)
        V = m.velocity(t)
        np.testing.assert_allclose(V[3:], (after - before)[:3, 3] / (2 * h), atol=1e-8)
        angular = se3.so3_log(after[:3, :3] @ before[:3, :3].T) / (2 * h)
        np.testing.assert_allclose(V[:3], angular, atol=1e-8)
        acceleration = (m.velocity(t + h) - m.velocity(t - h))[3:] / (2 * h)
        np.testing.assert_allclose(m.state(t)[2], acceleration, atol=1e-8)


def test_angular_speed_does_not_depend_on_the_axis_length():
    assert np.linalg.norm(motion().velocity(0.0)[:3]) == pytest.approx(0.7)
    longer = motion(spin_axis=np.array([10.0, -20.0, 5.0]))
    np.testing.assert_allclose(longer.velocity(0.0)[:3], motion().velocity(0.0)[:3])


def test_orientation_at_the_start():
    np.testing.assert_allclose(motion().pose(0.0)[:3, :3], motion().R_WO)
    still = motion(spin=0.0)
    np.testing.assert_allclose(still.pose(5.0)[:3, :3], still.R_WO)


def test_start_phase_shifts_the_translation_in_time():
    shifted = motion(start_phase=0.4 + 0.6 * 2.0)
    for t in TIMES:
        np.testing.assert_allclose(shifted.pose(t)[:3, 3], motion().pose(t + 2.0)[:3, 3])


def test_a_lap_ends_where_it_began():
    m = motion(harmonic=np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(m.pose(2 * np.pi / 0.6)[:3, 3], m.pose(0.0)[:3, 3])


PAPER = {
    "circular": (
        {"center": [0, 0, 0.2], "amplitude": [0.45, 0.45, 0], "offset_deg": [90, 0, 0]},
        lambda s: [0.45 * np.cos(s), 0.45 * np.sin(s), 0.2],
    ),
    "linear": (
        {"center": [0.45, 0, 0.2], "amplitude": [0, 0.45, 0.1]},
        lambda s: [0.45, 0.45 * np.sin(s), 0.2 + 0.1 * np.sin(s)],
    ),
    "sinusoidal": (
        {
            "center": [0.45, 0, 0.2],
            "amplitude": [0.1, 0.35, 0],
            "harmonic": [10, 1, 1],
            "offset_deg": [90, 0, 0],
        },
        lambda s: [0.45 + 0.1 * np.cos(10 * s), 0.35 * np.sin(s), 0.2],
    ),
}


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_trajectories(name):
    """Phase s = 0.3 rad/s x t; the object rolls by s about x."""
    values, position = PAPER[name]
    values = {"harmonic": [1, 1, 1], "offset_deg": [0, 0, 0], **values}
    m = motion(
        **{key: np.array(value, dtype=float) for key, value in values.items()},
        rate=0.3,
        start_phase=0.0,
        spin_axis=np.array([1.0, 0.0, 0.0]),
        spin=0.3,
        R_WO=np.eye(3),
    )
    for t in TIMES:
        s = 0.3 * t
        X_WO = m.pose(t)
        np.testing.assert_allclose(X_WO[:3, 3], position(s), atol=1e-12)
        roll = [[1, 0, 0], [0, np.cos(s), -np.sin(s)], [0, np.sin(s), np.cos(s)]]
        np.testing.assert_allclose(X_WO[:3, :3], roll, atol=1e-12)
