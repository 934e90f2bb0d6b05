"""Pages in a browser: a run in real time, with pause and a speed slider; a live camera."""

import json
import select
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.control.status import Status
from feasigrasp.models.grasps.glyphs import gripper_glyph, place_copies, spread_order
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.replay import camera_page, live_page, picture_text, status_words
from feasigrasp.systems.monitoring.camera_pictures import Picture, jpeg
from feasigrasp.systems.monitoring.meshcat_view import REACHABLE, GraspVisualizer, draw_surface


def serve(answer: Callable[[str, bytes], bytes | None]) -> str:
    """Serves a page to this computer alone, on a free port and from other threads.

    ``answer`` gives the content of a path, from what was posted to it; None if there is no such
    path. The result is the address of the page.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(handler) -> None:  # noqa: N805
            content = answer(handler.path, handler.rfile.read(handler._length()))
            handler.send_response(200 if content is not None else 404)
            kind = "text/html; charset=utf-8" if handler.path == "/" else "application/json"
            handler.send_header("Content-Type", kind)
            handler.send_header("Cache-Control", "no-store")
            handler.end_headers()
            handler.wfile.write(content or b"")

        do_POST = do_GET

        def _length(handler) -> int:  # noqa: N805
            given = handler.headers.get("Content-Length", "")
            return min(int(given), 1024) if given.isdigit() else 0

        def log_message(handler, format: str, *args: object) -> None:  # noqa: N805
            """Prints nothing."""

    server = ThreadingHTTPServer(("localhost", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://localhost:{server.server_port}/"


#: Names of the controls.
PAUSE, SPEED = "pause or go on", "speed [x real time]"
#: Greatest speed of the slider, at which the simulation is not held up. Source: guessed.
FASTEST = 2.0
#: Time between looks at the controls, the browser and the keyboard while it waits [s]. Source:
#: guessed.
_LOOK = 0.05


class LiveView:
    """A page with Meshcat, legend, status and camera picture, and controls of the simulation.

    Attributes:
        meshcat: Where to show the cell.
        url: Address of the page.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        """Adds the controls to a Meshcat, and serves; a browser may come at any time."""
        self.meshcat = meshcat
        self.meshcat.AddButton(PAUSE, "Space")
        self.meshcat.AddSlider(SPEED, min=0.1, max=FASTEST, step=0.1, value=1.0)
        self._speed = 0.0
        self.show(0.0, None, None)
        page = live_page(meshcat.port()).encode()
        self.url = serve(lambda path, _: {"/": page, "/state": self._state}.get(path))

    def show(self, time: float, status: Status | None, picture: Picture | None) -> None:
        """Sets what the page shows beside the cell: simulated time [s], status, camera picture."""
        words, shown = status and status_words(status), picture and picture_text(picture)
        self._state = json.dumps({"time": time, "status": words, "picture": shown}).encode()

    @property
    def paused(self) -> bool:
        """Whether the button was pressed an odd number of times."""
        return self.meshcat.GetButtonClicks(PAUSE) % 2 == 1

    def wait_for_browser(self, interrupted: threading.Event) -> None:
        """Waits until a browser shows the page, Enter is pressed, or the run is interrupted."""
        _wait(lambda: self.meshcat.GetNumActiveConnections() > 0 or interrupted.is_set())

    def stay(self) -> None:
        """Serves the page until Enter or Ctrl-C is pressed."""
        print(f"{self.url} stays open; Enter or Ctrl-C ends it", flush=True)
        try:
            _wait(lambda: False)
        except KeyboardInterrupt:
            print()  # behind the terminal's ^C

    def pace(self, simulator: Simulator, interrupted: threading.Event) -> None:
        """Runs a simulator at the speed of the slider; button or interrupt end a pause."""
        waited = False
        while self.paused and not interrupted.is_set():
            waited = True
            time.sleep(_LOOK)
        speed = self.meshcat.GetSliderValue(SPEED)
        if waited or speed != self._speed:
            self._speed = speed
            simulator.set_target_realtime_rate(speed if speed < FASTEST else 0.0)
            simulator.ResetStatistics()  # from here on: what is behind is not caught up


def _wait(over: Callable[[], bool]) -> None:
    """Waits until something is over, or a line or the end of the standard input is read."""
    while not over():
        try:
            readable = select.select([sys.stdin], [], [], _LOOK)[0]
        except (OSError, ValueError):  # there is no standard input
            return
        if readable:
            sys.stdin.readline()
            return


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
