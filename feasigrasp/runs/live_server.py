"""The page of a live view, served to browsers on this computer, and the state that it shows."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from feasigrasp.models.control.status import Status
from feasigrasp.runs.overlay import live_page, picture_text, status_words
from feasigrasp.systems.monitoring.camera_pictures import Picture


class LiveServer:
    """Serves the page, and under ``state`` what it shows, from a thread of its own.

    Attributes:
        url: Address of the page.
    """

    def __init__(self, meshcat_port: int) -> None:
        """Starts to serve on a free port.

        Args:
            meshcat_port: Port of the Meshcat that the page frames.
        """
        self.show(0.0, None, None)
        page = live_page(meshcat_port).encode()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(handler) -> None:  # noqa: N805
                content = {"/": page, "/state": self._state}.get(handler.path)
                handler.send_response(200 if content is not None else 404)
                kind = "text/html; charset=utf-8" if handler.path == "/" else "application/json"
                handler.send_header("Content-Type", kind)
                handler.send_header("Cache-Control", "no-store")
                handler.end_headers()
                handler.wfile.write(content or b"")

            def log_message(handler, format: str, *args: object) -> None:  # noqa: N805
                """Prints nothing."""

        server = ThreadingHTTPServer(("localhost", 0), Handler)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.url = f"http://localhost:{server.server_port}/"

    def show(self, time: float, status: Status | None, picture: Picture | None) -> None:
        """Sets what the page shows at its next look.

        Args:
            time: Simulated time [s].
            status: What goes on.
            picture: What the camera sees.
        """
        state = {
            "time": time,
            "status": status and status_words(status),
            "picture": picture and picture_text(picture),
        }
        self._state = json.dumps(state).encode()
