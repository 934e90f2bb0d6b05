"""Turns a rendered depth image into what a real stereo camera would have measured."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import CameraInfo, ImageDepth32F

from feasigrasp.models.clouds.depth_noise import DepthNoise


class NoisyDepth(LeafSystem):
    """Adds a depth camera's errors to its images.

    .. pydrake_system::

        name: NoisyDepth
        input_ports:
        - depth_image
        output_ports:
        - depth_image

    Both are ``ImageDepth32F`` [m]; a pixel without depth is infinite, one that is too near 0. The
    errors depend on the seed and the time only, so an image that is read twice is the same twice,
    and a run repeats.
    """

    def __init__(
        self,
        noise: DepthNoise,
        info: CameraInfo,
        seed: int = 0,
        *,
        near: float = 0.0,
        far: float = np.inf,
    ) -> None:
        """The errors of one camera; cameras with the same seed err alike.

        Args:
            noise: The errors.
            info: The depth camera's intrinsics.
            seed: Seed of the errors.
            near: Least depth that the camera measures [m].
            far: Largest depth that it measures [m].
        """
        super().__init__()
        self._noise, self._seed = noise, seed
        self._near, self._far = near, far
        self._intrinsics = (info.focal_x(), info.focal_y(), info.center_x(), info.center_y())
        image = AbstractValue.Make(ImageDepth32F(info.width(), info.height()))
        self._input = self.DeclareAbstractInputPort("depth_image", image)
        self.DeclareAbstractOutputPort("depth_image", image.Clone, self._calc)

    def _calc(self, context: Context, output) -> None:
        depth = self._input.Eval(context).data[:, :, 0]
        rng = np.random.default_rng([self._seed, round(1e6 * context.get_time())])
        noisy = self._noise.apply(depth, self._intrinsics, rng, near=self._near, far=self._far)
        output.get_mutable_value().mutable_data[:, :, 0] = noisy
