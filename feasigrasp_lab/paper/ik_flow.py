"""Inverse kinematics by a normalizing flow: samples of configurations for a flange pose.

A conditional normalizing flow in the sense of IKFlow (Ames, Morgan, Konidaris, "IKFlow: Generating
Diverse Inverse Kinematics Solutions", RA-L 2022): an invertible map from latents to configurations
that depends on the pose, trained by maximum likelihood on samples of forward kinematics alone.
Where IKFlow couples all joints over and over, this one goes along the chain once:

    p(q | X_WF) = prod_i p(q_i | X_i),    X_i = (X_WL(q_1 ... q_{i-1}))^-1 X_WF,

since of the joints before joint i, only the flange pose as seen from the link L that carries it
matters. Each factor is a mixture of logistic distributions on the circle, cut off at the joint's
limits; its weights, centres and scales come from a small network. Turning X_i about the joint's
axis turns the centres by the same angle, by construction. The flow's latents are the cumulative
distributions, uniform in the unit cube: ``u_i = P(q_i' <= q_i | X_i)``.

Inference needs NumPy and numba only. Everything that comes out lies inside the joint limits.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.quantities import POSES, ArrayOf, Whole
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.weights_file import WeightArrays, WeightsFormat, check_arrays
from feasigrasp_lab import WEIGHTS
from feasigrasp_lab.arm import refine
from feasigrasp_lab.paper.ik_flow_layers import (
    FEATURES,
    FlowShape,
    features_kernel,
    quantile_kernel,
    turn_kernel,
)

WeightArray = NDArray[np.float32]

#: Where the trained weights are.
DEFAULT_WEIGHTS = WEIGHTS / "ik_flow.npz"
_FILE = WeightsFormat("IK flow", "feasigrasp ik_flow 1", "feasigrasp train ik-flow")
#: Damping of the refinement steps. Source: guessed.
DAMPING = 0.01
#: Rows that go through the networks together: bounds the memory. Source: numerical.
_CHUNK = 4096
_LATENTS = ArrayOf(("n", IIWA_7.joints))


@dataclass(frozen=True, eq=False)
class IkFlow(Frozen):
    """A trained flow.

    Attributes:
        shape: Sizes of its networks.
        arrays: Their weights by name, see `FlowShape.array_shapes`.
    """

    shape: FlowShape
    arrays: dict[str, WeightArray]

    def __post_init__(self) -> None:
        """Checks the arrays.

        Raises:
            ArgumentError: One is missing, or has another shape than the sizes say.
        """
        check_fields(self)
        try:
            check_arrays(self.arrays, self.shape.array_shapes())
        except ValueError as error:
            raise ArgumentError(f"IkFlow.arrays: {error}") from None

    @classmethod
    @checked()
    def load(cls, path: str | Path) -> IkFlow:
        """Loads a flow that `save` wrote.

        Raises:
            WeightsError: The file is missing, broken, or does not match the sizes it names.
        """
        return _FILE.load(path, cls._of)

    @classmethod
    def _of(cls, header: dict[str, Any], arrays: WeightArrays) -> IkFlow:
        shape = FlowShape.from_dict(header["shape"])
        for array in arrays.values():
            array.flags.writeable = False
        return cls(shape, arrays)

    @checked()
    def save(self, path: str | Path) -> None:
        """Writes sizes and weights into one ``.npz`` file, whole or not at all."""
        _FILE.save(path, {"shape": asdict(self.shape)}, self.arrays)

    @checked()
    def sample(self, X_WF: Annotated[ArrayLike, POSES], seed: Whole = 0) -> Array:
        """Draws one configuration of each pose, not refined yet.

        The latents depend on the seed and the place in the batch alone: the same call with poses
        that have moved a little gives configurations that have moved a little.

        Args:
            X_WF: Flange poses (n, 4, 4) [m].
            seed: Of the latents.

        Returns:
            Shape (n, 7) [rad], inside the joint limits.

        Raises:
            ArgumentError: The poses have another shape, are not finite, or are none.
        """
        X_WF = np.asarray(X_WF)
        return self.inverse(X_WF, np.random.default_rng(seed).random((len(X_WF), IIWA_7.joints)))

    @checked()
    def solve(self, X_WF: Annotated[ArrayLike, POSES], seed: Whole = 0) -> Array:
        """One configuration of each pose: a `sample`, refined by 3 steps of damped least squares.

        A few do not reach their pose: compare forward kinematics.
        """
        X_WF = np.asarray(X_WF)
        return refine(X_WF, self.sample(X_WF, seed), 3, DAMPING)[0]

    @checked()
    def inverse(
        self, X_WF: Annotated[ArrayLike, POSES], u: Annotated[ArrayLike, _LATENTS]
    ) -> Array:
        """From latents to configurations.

        Args:
            X_WF: Flange poses (n, 4, 4) [m].
            u: Latents (n, 7) in the unit cube.

        Returns:
            Joint positions (n, 7) [rad], inside the limits.

        Raises:
            ArgumentError: Latents outside the unit cube, or poses as in `sample`.
        """
        X_WF = np.asarray(X_WF)
        u = np.asarray(u)
        if not ((u >= 0.0) & (u <= 1.0)).all():
            raise ArgumentError("IkFlow.inverse: u holds latents outside [0, 1]")
        q = np.empty(u.shape)
        # Matrix products keep to one thread: more cost time on a busy machine.
        with _threads().limit(limits=1, user_api="blas"):
            for start in range(0, len(q), _CHUNK):
                part = slice(start, start + _CHUNK)
                self._inverse(X_WF[part, :3].copy(), u[part], q[part])
        return q

    def _inverse(self, target: Array, u: Array, q: Array) -> None:
        """Writes the configurations; moves the targets (n, 3, 4) along the chain."""
        for joint in range(IIWA_7.joints):
            head, azimuth = self._head(target, joint)
            angle = np.empty(len(target))
            mixture = head, self.shape.narrowest, azimuth, IIWA_7.upper[joint]
            quantile_kernel(*mixture, u[:, joint], angle)
            turn_kernel(target, joint, angle)
            q[:, joint] = angle

    def _head(self, target: Array, joint: int) -> tuple[WeightArray, Array]:
        """Outputs of a joint's network; moves the targets (n, 3, 4) to the joint."""
        features = np.empty((len(target), FEATURES), dtype=np.float32)
        azimuth = np.empty(len(target))
        features_kernel(target, joint, features, azimuth)
        name, x = f"factors.{joint}", features
        for i in range(len(self.shape.hidden[joint])):
            x = x @ self.arrays[f"{name}.layers.{i}.weight"].T
            x += self.arrays[f"{name}.layers.{i}.bias"]
            x /= 1.0 + np.exp(-x)  # SiLU
        head = x @ self.arrays[f"{name}.head.weight"].T
        head += self.arrays[f"{name}.head.bias"]
        k = self.shape.components[joint]
        head[:, k : 3 * k] += features @ self.arrays[f"{name}.skip.weight"].T
        return head, azimuth


@lru_cache(maxsize=1)
def load_ik_flow() -> IkFlow:
    """The flow that comes with the package, loaded once.

    Raises:
        WeightsError: See `IkFlow.load`.
    """
    return IkFlow.load(DEFAULT_WEIGHTS)


@lru_cache(maxsize=1)
def _threads() -> ThreadpoolController:
    return ThreadpoolController()
