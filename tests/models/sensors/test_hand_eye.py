"""The error of a calibration: its size is given, its direction is drawn."""

import numpy as np
import pytest

from feasigrasp.errors import CameraError
from feasigrasp.models.sensors.camera_errors import HandEyeError


def test_the_error_has_the_given_size_and_any_direction():
    error = HandEyeError(0.002, 0.5)
    drawn = np.array([error.draw(np.random.default_rng(seed)) for seed in range(200)])
    np.testing.assert_allclose(np.linalg.norm(drawn[:, :3, 3], axis=1), 0.002)
    traces = np.einsum("nii->n", drawn[:, :3, :3])
    np.testing.assert_allclose(np.rad2deg(np.arccos((traces - 1.0) / 2.0)), 0.5, atol=1e-6)
    assert np.abs(drawn[:, :3, 3].mean(axis=0)).max() < 0.0004


def test_without_an_error_the_camera_is_where_it_is_believed_to_be():
    np.testing.assert_array_equal(HandEyeError().draw(np.random.default_rng(0)), np.eye(4))


def test_a_negative_size_is_refused():
    with pytest.raises(CameraError, match="hand_eye_angle_deg = -1"):
        HandEyeError(hand_eye_angle_deg=-1)
