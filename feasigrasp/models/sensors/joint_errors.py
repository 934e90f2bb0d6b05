"""Errors of the joint sensors of an iiwa: encoders, and torques that only contact explains.

All sizes are choices. A torque errs by up to 2 % of the largest one, the order of the torque
accuracy in KUKA's data sheet of the LBR iiwa; encoders resolve 0.01 deg, the order of the arm's
ancestor, DLR's LWR III (neither figure verified at the source). Where in that band an axis errs is
drawn: half of it is constant, half goes with the sine of the joint angle, as what a model of the
arm's weight leaves does. A noise of 0.5 % stands for what is left of the periodic ripple of the
gears, which Chawda and Niemeyer describe ("Toward torque control of a KUKA LBR iiwa for physical
human-robot interaction", IROS 2017; the size is not theirs). Zeros off by 0.02 deg move the hand by
0.5 mm.

Left out: friction, elasticity of the joints, drift with temperature, the ripple's frequency, and
the time that the arm's own observer takes.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import key


@dataclass
class JointErrors:
    """Sizes of the errors.

    Attributes:
        encoder_step_deg: Least difference of two measured positions [deg].
        encoder_zero_deg: Standard deviation of the zeros of the joints [deg].
        torque_accuracy: Largest error of an external torque that stays, in shares of the largest
            torque of its joint.
        torque_noise: Standard deviation of its noise, likewise.
    """

    encoder_step_deg: float = key(0.01, 0.0, 1.0, "deg")
    encoder_zero_deg: float = key(0.02, 0.0, 1.0, "deg")
    torque_accuracy: float = key(0.02, 0.0, 1.0)
    torque_noise: float = key(0.005, 0.0, 1.0)

    def scaled(self, factor: float) -> Self:
        """Joints that err ``factor`` times as much."""
        return type(self)(**{name: factor * value for name, value in vars(self).items()})


#: Makes the seeds of joints others than those of cameras. Source: layout.
_JOINTS = 2**42


class DrawnJointErrors:
    """The errors of one arm."""

    def __init__(self, errors: JointErrors, largest: Array, seed: int) -> None:
        """Draws errors of these sizes for an arm whose largest torques are (n,) [Nm]."""
        n, rng = len(largest), np.random.default_rng([seed, _JOINTS])
        self._noise = errors.torque_noise * largest
        self._step, self._seed = np.deg2rad(errors.encoder_step_deg), seed
        #: What is measured where a joint is at zero, shape (n,) [rad].
        self.zero: Array = np.deg2rad(errors.encoder_zero_deg) * rng.standard_normal(n)
        self._torque = 0.5 * errors.torque_accuracy * largest
        self._constant, self._phase = rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)

    def position(self, q: Array) -> Array:
        """Measured positions of joints that are at q, shape (n,) [rad]."""
        measured = q + self.zero
        if self._step > 0.0:
            measured = self._step * np.rint(measured / self._step)
        return np.asarray(measured)

    def torque(self, torque: Array, q: Array, time: float) -> Array:
        """Reported external torques, shape (n,) [Nm], for the true ones at true positions q [rad].

        Equal times [s] have equal noise.
        """
        rng = np.random.default_rng([self._seed, _JOINTS, round(1e6 * time)])
        stays = self._torque * (self._constant + np.sin(q + self._phase))
        return np.asarray(torque + stays + self._noise * rng.standard_normal(len(q)))
