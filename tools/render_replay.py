"""Renders one moment of a replay to a PNG in headless Chromium.

For example::

    python tools/render_replay.py out/demo/replay.html out/demo/picture.png --time 2.5
"""

import argparse
import sys
import tempfile
from pathlib import Path

from feasigrasp.cli import exit_status
from feasigrasp.errors import InputError
from feasigrasp.runs.replay import screenshot

#: Moves the animation to a time as soon as it is there, and hides the controls.
_SEEK = """
<style>.dg, #grasp-bar {{ display: none !important; }}</style>
<script>
  setInterval(() => {{
    const animator = viewer.animator;
    if (animator.actions.length > 0) {{
      animator.pause();
      animator.seek({time});
    }}
  }}, 100);
</script>
"""


def parse_arguments() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("replay", type=Path, help="HTML file written with --replay")
    parser.add_argument("image", type=Path, help="PNG file to write")
    parser.add_argument("--time", type=float, default=0.0, help="moment to show [s]")
    parser.add_argument("--size", type=int, nargs=2, default=(1200, 800), metavar=("W", "H"))
    return parser.parse_args()


def render(replay: Path, image: Path, time: float, size: tuple[int, int]) -> None:
    """Writes a picture of a replay.

    Args:
        replay: HTML file of a recording.
        image: PNG file to write.
        time: Moment to show [s]; past the end it is the last picture.
        size: Width and height [pixels].

    Raises:
        InputError: There is no such replay.
        BrowserError: There is no browser, or it makes no picture.
    """
    if not replay.is_file():
        raise InputError(f"there is no file {replay}")
    with tempfile.TemporaryDirectory(prefix="replay-") as folder:
        page = Path(folder) / "replay.html"
        page.write_text(replay.read_text().replace("</body>", _SEEK.format(time=time) + "</body>"))
        screenshot(page, image, size)


def main() -> int:
    """Renders one picture."""
    args = parse_arguments()
    render(args.replay, args.image, args.time, tuple(args.size))
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
