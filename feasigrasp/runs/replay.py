"""Records a simulation in Meshcat as one offline HTML file."""

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from feasigrasp.models.control.status import Status
from feasigrasp.outputs import write_text
from feasigrasp.runs.overlay import replay_overlay
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
