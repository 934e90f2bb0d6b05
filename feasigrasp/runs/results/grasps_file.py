"""JSON format of grasps for other programs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from feasigrasp import __version__
from feasigrasp.errors import OutputError
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.outputs import write_text

FORMAT = "feasigrasp-grasps-1"
#: The frames that poses may be in; what the file says of them.
FRAMES = {
    "camera": "origin in the camera, x right, y down, z forward",
    "cloud": "the frame of the points in the source file",
}
CONVENTION = (
    "a pose is the 4 x 4 matrix that takes points from the grasp's frame to this frame; the "
    "grasp's frame: origin between the pads, x the direction in which they close, z the direction "
    "in which the hand approaches, y = z cross x; a width is the distance between the contacts; "
    "metres; best score first"
)


def check_suffix(option: str, file: Path | None) -> None:
    """Refuses a file that is not named as JSON.

    Raises:
        OutputError: It is not.
    """
    if file is not None and file.suffix.lower() != ".json":
        raise OutputError(f"{option} {file}: end it in .json")


def write_grasps(file: Path, grasps: GraspSet, frame: str, source: Path) -> None:
    """Writes poses, widths and scores, and what they mean; none are empty lists.

    Args:
        file: The file.
        grasps: The grasps, of a hand with frame G, in one of `FRAMES`.
        frame: That frame.
        source: What was perceived.

    Raises:
        OutputError: It cannot be written.
    """
    order = np.argsort(-grasps.score, kind="stable")
    content = {
        "format": FORMAT,
        "feasigrasp": __version__,
        "source": str(source),
        "frame": frame,
        "frame_axes": FRAMES[frame],
        "convention": CONVENTION,
        "poses": grasps.X_OG[order].round(6).tolist(),
        "widths": grasps.width[order].round(6).tolist(),
        "scores": grasps.score[order].round(6).tolist(),
    }
    write_text(file, json.dumps(content) + "\n")
