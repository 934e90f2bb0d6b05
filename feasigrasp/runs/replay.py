"""Records a simulation in Meshcat as one offline HTML file, with a still picture."""

import logging
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

from feasigrasp.errors import FeasigraspError
from feasigrasp.models.control.status import Status
from feasigrasp.outputs import write_text
from feasigrasp.runs.overlay import replay_overlay
from feasigrasp.systems.monitoring.camera_pictures import Picture

#: Pictures per simulated second. Source: layout.
FRAMES_PER_SECOND = 32.0
#: Browsers that take pictures without a window.
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class BrowserError(FeasigraspError, RuntimeError):
    """No browser, or one that takes no pictures."""


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


def screenshot(page: Path, picture: Path, size: tuple[int, int]) -> None:
    """Writes a PNG of an HTML page, as a browser without a window shows it after some seconds.

    The size is width and height [pixels].

    Raises:
        BrowserError: There is no browser, or it takes no picture.
    """
    program = browser()
    if program is None:
        raise BrowserError(f"there is no browser for pictures: install {BROWSERS[0]}")
    with tempfile.TemporaryDirectory(prefix="feasigrasp-") as folder:
        shot = Path(folder) / "shot.png"
        command = [
            program,
            "--headless",
            "--no-sandbox",  # the sandbox does not start as root, e.g. in a container
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--hide-scrollbars",
            "--virtual-time-budget=6000",
            f"--user-data-dir={folder}/profile",
            f"--window-size={size[0]},{size[1]}",
            f"--screenshot={shot}",
            page.resolve().as_uri(),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        except (OSError, subprocess.SubprocessError) as error:
            raise BrowserError(f"{program}: {error}") from error
        if not shot.is_file():
            raise BrowserError(f"{program} made no picture: {done.stderr[-2000:]}")
        picture.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(shot, picture)


def take_picture(replay: Path) -> bool:
    """Renders a replay, as it stands some seconds after it began to play, to a PNG beside it.

    Returns:
        Whether there is a picture that is not older than the replay.
    """
    picture = replay.with_suffix(".png")
    if not replay.exists():
        return False
    with suppress(BrowserError):
        if not (picture.exists() and picture.stat().st_mtime >= replay.stat().st_mtime):
            screenshot(replay, picture, (960, 600))
        return True
    return False
