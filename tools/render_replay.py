"""Renders one moment of a replay to a PNG in headless Chromium.

For example::

    python tools/render_replay.py out/demo/replay.html out/demo/picture.png --time 2.5
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

#: Moves the animation to a time as soon as it is there, and hides the controls.
_SEEK = """
<style>.dg {{ display: none !important; }}</style>
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
    parser.add_argument("--chromium", default="chromium", help="name or path of the browser")
    return parser.parse_args()


def render(
    replay: Path, image: Path, time: float, size: tuple[int, int], chromium: str = "chromium"
) -> None:
    """Writes a picture of a replay.

    Args:
        replay: HTML file of a recording.
        image: PNG file to write.
        time: Moment to show [s]; past the end it is the last picture.
        size: Width and height [pixels].
        chromium: Name or path of the browser.

    Raises:
        FileNotFoundError: If there is no such replay or browser.
        RuntimeError: If the browser makes no picture.
    """
    browser = shutil.which(chromium)
    if browser is None:
        raise FileNotFoundError(f"no {chromium!r} on the PATH; name a Chromium with --chromium")
    html = replay.read_text()
    image.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="replay-") as folder:
        page, shot = Path(folder) / "replay.html", Path(folder) / "shot.png"
        page.write_text(html.replace("</body>", _SEEK.format(time=time) + "</body>"))
        command = [
            browser,
            "--headless",
            "--no-sandbox",  # the sandbox does not start as root, e.g. in a container
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--hide-scrollbars",
            f"--user-data-dir={folder}/profile",
            f"--window-size={size[0]},{size[1]}",
            "--virtual-time-budget=8000",
            f"--screenshot={shot}",
            page.as_uri(),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        if not shot.is_file():
            raise RuntimeError(f"{browser} made no picture:\n{done.stderr[-2000:]}")
        shutil.move(shot, image)


def main() -> int:
    """Renders one picture."""
    args = parse_arguments()
    try:
        render(args.replay, args.image, args.time, tuple(args.size), args.chromium)
    except (FileNotFoundError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
