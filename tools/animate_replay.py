"""Renders a replay as an animation, frame by frame in headless Chromium.

For example::

    python tools/animate_replay.py belt.html docs/images/demo.webp --look 0.36 0 0.54 5
"""

import argparse
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image
from tqdm import tqdm

from feasigrasp.cli import exit_status
from tools.render_replay import add_look, render


def parse_arguments() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("replay", type=Path, help="HTML file written with --replay")
    parser.add_argument("image", type=Path, help="WebP or GIF file to write")
    parser.add_argument("--until", type=float, default=9.2, help="last moment [s]")
    parser.add_argument("--frames", type=int, default=56, help="how many pictures")
    parser.add_argument("--width", type=int, default=720, help="of the file [pixels]")
    add_look(parser)
    parser.add_argument("--jobs", type=int, default=2, help="browsers at a time")
    return parser.parse_args()


def animate(args: argparse.Namespace) -> None:
    """Renders the pictures, and writes them as one file that plays in real time, again and again.

    Raises:
        InputError: There is no such replay.
        BrowserError: There is no browser, or it makes no picture.
    """
    times = np.linspace(0.0, args.until, args.frames)
    with tempfile.TemporaryDirectory(prefix="replay-") as folder:
        shots = [Path(folder) / f"{k}.png" for k in range(args.frames)]

        def take(shot: Path, time: float) -> None:
            render(args.replay, shot, float(time), (1080, 720), args.look)

        with ThreadPoolExecutor(args.jobs) as pool:
            list(tqdm(pool.map(take, shots, times), total=len(shots), desc="pictures"))
        frames = [Image.open(shot).convert("RGB") for shot in shots]
    height = round(args.width * frames[0].height / frames[0].width)
    small = [frame.resize((args.width, height)) for frame in frames]
    milliseconds = round(1e3 * args.until / (args.frames - 1))
    args.image.parent.mkdir(parents=True, exist_ok=True)
    small[0].save(
        args.image,
        save_all=True,
        append_images=small[1:],
        duration=[milliseconds] * (len(small) - 1) + [1500],
        loop=0,
        quality=60,
        method=6,
    )


def main() -> int:
    """Makes one moving picture."""
    animate(parse_arguments())
    return 0


if __name__ == "__main__":
    sys.exit(exit_status(main))
