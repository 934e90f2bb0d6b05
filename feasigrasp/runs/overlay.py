"""HTML overlay of Meshcat: legend, status line and camera picture."""

import base64
import json
from collections.abc import Sequence
from importlib import resources
from string import Template

from feasigrasp.models.control.status import Status
from feasigrasp.systems.monitoring.camera_pictures import Picture

_BAR = (
    '<div id="grasp-bar"><button title="space"></button>'
    '<input type="range" min="0" step="any" value="0" aria-label="time"><output></output></div>'
)


def replay_overlay(history: Sequence[Status], pictures: Sequence[Picture], ghost: str = "") -> str:
    """Overlay of a replay, and its playback bar, of statuses and camera pictures by time.

    The mode of the translucent arm is ``ghost``, empty without one.
    """
    statuses = [[status.time, *status_words(status)] for status in history]
    shown = [[picture.time, picture_text(picture)] for picture in pictures]
    script = _page("replay.html", statuses=_script(statuses), pictures=_script(shown))
    row = f'<div><i class="ghost"></i>the arm in mode {ghost}</div>' if ghost else ""
    return _page("overlay.html", ghost=row, bar=_BAR, script=script)


def live_page(port: int) -> str:
    """The page that frames the Meshcat of a port, and shows the state of a run over it."""
    return _page("live.html", overlay=_page("overlay.html", ghost="", bar="", script=""), port=port)


def camera_page(port: int) -> str:
    """The page that shows a camera's images, to choose the object in, beside that Meshcat."""
    return _page("camera.html", port=port)


def status_words(status: Status) -> list[str]:
    """Code and detail of a status, as they are shown."""
    return [str(status.code).replace("_", " "), status.detail]


def picture_text(picture: Picture) -> str:
    """A picture's file as base64."""
    return base64.b64encode(picture.jpeg).decode()


def _page(name: str, **values: object) -> str:
    page = resources.files("feasigrasp.runs").joinpath(name)
    return Template(page.read_text()).substitute(values)


def _script(value: object) -> str:
    """JSON that cannot end the script that it stands in."""
    return json.dumps(value).replace("</", "<\\/")
