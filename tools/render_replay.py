"""Renders one moment of a replay to a PNG in headless Chromium.

For example::

    python tools/render_replay.py out/demo/replay.html out/demo/picture.png --time 2.5
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from feasigrasp.cli import exit_status
from feasigrasp.errors import InputError
from feasigrasp_lab.report.screenshot import screenshot

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
    {look}
  }}, 100);
</script>
"""
#: Turns the camera to a place, three.js having y up, and zooms.
_LOOK = """viewer.controls.target.set({0}, {2}, -({1}));
    viewer.camera.zoom = {3};
    viewer.camera.updateProjectionMatrix();
    viewer.controls.update();
    viewer.set_dirty();"""


def parse_arguments() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("replay", type=Path, help="HTML file written with --replay")
    parser.add_argument("image", type=Path, help="PNG file to write")
    add_look(parser)
    parser.add_argument("--time", type=float, default=0.0, help="moment to show [s]")
    parser.add_argument("--size", type=int, nargs=2, default=(1200, 800), metavar=("W", "H"))
    return parser.parse_args()


def add_look(parser: argparse.ArgumentParser) -> None:
    """Adds the option that says where the picture's camera looks."""
    help_text = "place to look at [m], and zoom; default: as the replay begins"
    parser.add_argument(
        "--look", type=float, nargs=4, metavar=("X", "Y", "Z", "ZOOM"), help=help_text
    )


def render(
    replay: Path,
    image: Path,
    time: float,
    size: tuple[int, int],
    look: Sequence[float] | None = None,
) -> None:
    """Writes a picture of a replay.

    Args:
        replay: HTML file of a recording.
        image: PNG file to write.
        time: Moment to show [s]; past the end it is the last picture.
        size: Width and height [pixels].
        look: Place in the world frame that is looked at [m], and zoom; None: as the replay begins.

    Raises:
        InputError: There is no such replay.
        BrowserError: There is no browser, or it makes no picture.
    """
    if not replay.is_file():
        raise InputError(f"there is no file {replay}")
    with tempfile.TemporaryDirectory(prefix="replay-") as folder:
        page = Path(folder) / "replay.html"
        seek = _SEEK.format(time=time, look="" if look is None else _LOOK.format(*look))
        page.write_text(replay.read_text().replace("</body>", seek + "</body>"))
        screenshot(page, image, size)


def main() -> int:
    """Renders one picture."""
    args = parse_arguments()
    render(args.replay, args.image, args.time, tuple(args.size), args.look)
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
