"""Still pictures of replays, by a browser without a window."""

import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path

from feasigrasp.errors import FeasigraspError
from feasigrasp.runs.replay import BROWSERS, browser


class BrowserError(FeasigraspError, RuntimeError):
    """No browser, or one that takes no pictures."""


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
