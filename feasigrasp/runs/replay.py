"""Records a simulation in Meshcat as one offline HTML file; the pages with legend and status."""

import base64
import json
import logging
import shutil
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template

from pydrake.geometry import Meshcat, MeshcatParams

from feasigrasp.models.control.status import Status
from feasigrasp.outputs import write_text
from feasigrasp.systems.monitoring.camera_pictures import Picture

#: Pictures per simulated second. Source: layout.
FRAMES_PER_SECOND = 32.0
#: Browsers that take pictures without a window.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def quiet_meshcat() -> Meshcat:
    """A Meshcat that neither opens a browser, nor needs a particular port, nor announces it."""
    drake_log = logging.getLogger("drake")
    level = drake_log.level
    drake_log.setLevel(logging.WARNING)  # do not announce an address without use
    try:
        return Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    finally:
        drake_log.setLevel(level)


def start_recording(watched: Meshcat | None = None) -> Meshcat:
    """Starts the recording of a Meshcat: the visible one, or a hidden one."""
    meshcat = watched or quiet_meshcat()
    meshcat.StartRecording(
        FRAMES_PER_SECOND, set_visualizations_while_recording=watched is not None
    )
    return meshcat


def write_replay(
    meshcat: Meshcat,
    filename: Path,
    history: Sequence[Status] = (),
    pictures: Sequence[Picture] = (),
    ghost: str = "",
) -> None:
    """Writes what a Meshcat has recorded as a self-contained HTML file.

    With a history of statuses a line at the foot of the page says them, and there are a legend and
    a bar that plays; without it there is nothing but the recording. An inset shows the pictures.
    ``ghost`` is the mode of the translucent arm, if there is one.
    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    write_html(meshcat, filename, replay_overlay(history, pictures, ghost) if history else "")


def write_html(meshcat: Meshcat, filename: Path, extra: str = "") -> None:
    """Writes what is shown as a self-contained HTML file, with something extra on the page."""
    page = meshcat.StaticHtml()
    end = page.rindex("</body>")
    write_text(filename, page[:end] + extra + page[end:])


def browser() -> str | None:
    """A browser that takes pictures without a window; None if there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


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
