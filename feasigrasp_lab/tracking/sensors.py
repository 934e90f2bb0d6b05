"""Applies a sensor model to a recording with perfect depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feasigrasp.models.clouds.camera import Camera, unproject
from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp_lab.tracking.recording import Recording


@dataclass(frozen=True)
class Sensor:
    """A depth camera.

    Attributes:
        noise: Its errors.
        near: Least depth that it measures [m].
    """

    noise: DepthNoise
    near: float


#: Those that the tracker is judged with; focal length and size are those of the recording. The
#: second has the errors of the Reach scenarios' camera, but for its calibration.
SENSORS = {
    "d435": Sensor(DepthNoise(), 0.105),
    "d405": Sensor(
        DepthNoise(baseline=0.018, correlation=1.0, motion_blur=1.0, dropped=0.02), 0.07
    ),
}


def images(
    recording: Recording, sensor: Sensor, seed: int, hidden: tuple[float, float] = (0.0, 0.0)
) -> Iterator[tuple[int, ObjectView]]:
    """The images of a recording, as a sensor would have made them.

    Args:
        recording: The recording.
        sensor: The sensor.
        seed: Of its errors.
        hidden: From when to when something hides the object [s].
    """
    h, w = recording.depths.shape[1:]
    fx, fy, cx, cy = recording.intrinsics
    camera = Camera((fx, fy, cx, cy), w, h, sensor.near, sensor.noise.axial(fx))
    for k, X_WC in enumerate(recording.X_WC):
        depth = recording.depth(k)
        depth[depth < sensor.near] = 0.0
        rng = np.random.default_rng([seed, k])
        depth = sensor.noise.apply(depth, recording.intrinsics, rng, near=sensor.near, far=3.0)
        if hidden[0] < recording.times[k] < hidden[1]:
            depth[:] = 0.0
        seen = np.isfinite(depth) & (depth > 0.0)
        points = unproject(np.where(seen, depth, np.inf), camera.intrinsics)
        mask = recording.masks[k]
        used = mask & seen & ~edge_pixels(points, seen, mask, EDGE_JUMP)
        points_W = points[:, used].T @ X_WC[:3, :3].T + X_WC[:3, 3]
        yield k, ObjectView(camera, X_WC, points_W, depth)
