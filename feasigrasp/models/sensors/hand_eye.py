"""Error model of the hand-eye calibration."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import key
from feasigrasp.models.quantities import NotNegative


@dataclass(frozen=True)
class HandEyeError:
    """Residual error of the hand-eye calibration: a constant pose error in the camera frame.

    Attributes:
        hand_eye_position: How far off its place is [m].
        hand_eye_angle_deg: By which angle its orientation is off [deg].
    """

    hand_eye_position: NotNegative = key(0.0, 0.0, 0.1, "m")
    hand_eye_angle_deg: NotNegative = key(0.0, 0.0, 30.0, "deg")

    def __post_init__(self) -> None:
        """Raises CameraError for a size that is negative or not finite."""
        check_fields(self, CameraError)

    def scaled(self, factor: float) -> Self:
        """A calibration that errs ``factor`` times as much."""
        return type(self)(**{name: factor * value for name, value in vars(self).items()})

    def draw(self, rng: np.random.Generator) -> Array:
        """The calibrated pose in the frame of the true camera, X_CB, (4, 4).

        The directions of both errors are drawn; the sizes are what they are.
        """
        axes = rng.standard_normal((2, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        X_CB = np.eye(4)
        turn = np.deg2rad(self.hand_eye_angle_deg) * axes[0]
        X_CB[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        X_CB[:3, 3] = self.hand_eye_position * axes[1]
        return X_CB
