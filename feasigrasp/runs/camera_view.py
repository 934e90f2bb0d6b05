"""Page of a live camera: its images, in which the object is chosen, beside what is tracked."""

from __future__ import annotations

import json
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.grasps.glyphs import gripper_glyph, place_copies, spread_order
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.live import serve
from feasigrasp.runs.overlay import camera_page, picture_text
from feasigrasp.systems.monitoring.camera_pictures import Picture, jpeg
from feasigrasp.systems.monitoring.grasp_visualizer import REACHABLE, GraspVisualizer, draw_surface


class CameraView:
    """A page with the images of a camera and a Meshcat, in which surface and grasps move.

    The camera's frame is drawn upright; what is in the object's frame is under ``/camera/object``.

    Attributes:
        url: Address of the page.
        grasps: The latest grasps, in O; None before the first.
    """

    def __init__(self, meshcat: Meshcat, camera: Camera, sampler: GraspSamplerFn) -> None:
        """Starts to serve the page, on this computer alone."""
        self.grasps: GraspSet | None = None
        self._meshcat, self._camera, self._sampler = meshcat, camera, sampler
        self._glyph = gripper_glyph(ParallelGripper())
        self._box: Array | None = None
        self._gpdf: Gpdf | None = None
        self._state, self._page = b"{}", camera_page(meshcat.port()).encode()
        self._pool, self._found = ThreadPoolExecutor(1), Future[GraspSet]()
        # Meshcat's up is z, the camera's is -y.
        upright = RigidTransform(RollPitchYaw(-np.pi / 2, 0.0, 0.0), np.zeros(3))
        meshcat.SetTransform("/camera", upright)
        self.url = serve(self._answer)

    def box(self) -> Array | None:
        """The box that was drawn since the last call [px], or twice the point of a click."""
        box, self._box = self._box, None
        return box

    def show(self, words: str, color: NDArray[np.uint8], X_CO: Array | None = None) -> None:
        """Shows an image (h, w, 3), words on it, and where the object is in it."""
        mask: Mask = np.zeros(color.shape[:2], dtype=bool)
        if X_CO is not None and self._gpdf is not None:
            self._meshcat.SetTransform("/camera/object", RigidTransform(X_CO))
            p = self._gpdf.completion.points @ X_CO[:3, :3].T + X_CO[:3, 3]
            column, row = np.rint(self._camera.pixels(p[p[:, 2] > self._camera.near])).astype(int)
            inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
            mask[row[inside], column[inside]] = True
        picture = picture_text(Picture(0.0, jpeg(color, mask, color.shape[1])))
        self._state = json.dumps({"words": words, "picture": picture}).encode()

    def draw(self, gpdf: Gpdf | None) -> None:
        """Draws the surface if it is another one, and the grasps on it when they are found."""
        if self._found.done() and self.grasps is not (found := self._found.result()):
            self.grasps = found
            best = found.X_OG[spread_order(found.X_OG, found.score)]
            vertices, faces = place_copies(best[: GraspVisualizer.MAX_REACHABLE], *self._glyph)
            path = "/camera/object/grasps"
            self._meshcat.SetTriangleMesh(path, vertices.T, faces.T, REACHABLE)
        if gpdf is None or gpdf is self._gpdf or (self._gpdf and not self._found.done()):
            return
        self._gpdf = gpdf
        draw_surface(self._meshcat, "/camera/object/surface", gpdf)
        self._found = self._pool.submit(self._sampler, gpdf)

    def _answer(self, path: str, posted: bytes) -> bytes | None:
        if path == "/box":
            size = np.tile([self._camera.width, self._camera.height], 2)
            try:
                shares = np.array(json.loads(posted), dtype=float).reshape(4)
            except (TypeError, ValueError):
                return None
            if np.isfinite(shares).all():
                self._box = np.clip(shares, 0.0, 1.0) * (size - 1)
            return b"{}"
        return {"/": self._page, "/state": self._state}.get(path)
