"""Pictures of replays, taken by a browser that shows no window."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

#: Size of the pictures [pixels].
_WIDTH, _HEIGHT = 960, 600
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def take_picture(replay: Path) -> bool:
    """Renders a replay, as it stands at its start, to a PNG beside it.

    Returns:
        Whether there is a picture that is not older than the replay.
    """
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    picture = replay.with_suffix(".png")
    if not replay.exists():
        return False
    if picture.exists() and picture.stat().st_mtime >= replay.stat().st_mtime:
        return True
    if browser is None:
        return False
    with tempfile.TemporaryDirectory(prefix="feasigrasp-") as profile:
        command = [
            browser,
            "--headless",
            "--no-sandbox",
            "--use-gl=swiftshader",
            "--enable-unsafe-swiftshader",
            "--virtual-time-budget=6000",
            f"--user-data-dir={profile}",
            f"--window-size={_WIDTH},{_HEIGHT}",
            f"--screenshot={picture.resolve()}",
            replay.resolve().as_uri(),
        ]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=120)
        except (OSError, subprocess.SubprocessError):
            return False
    return picture.exists()
