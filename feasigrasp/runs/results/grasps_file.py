"""Files of grasps for other programs, and of theirs: JSON, npz, GraspNet's 17 columns."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp import __version__
from feasigrasp.errors import InputError
from feasigrasp.inputs import read_arrays, read_json
from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.outputs import replacing, write_text

#: The frames that poses may be in; what the file says of them.
FRAMES = {
    "camera": "origin in the camera, x right, y down, z forward",
    "cloud": "the frame of the points in the source file",
}


def write_grasps(file: Path, grasps: GraspSet, frame: str, source: Path) -> None:
    """Writes poses, widths and scores, and what they mean; none are empty lists.

    An ``.npy`` has the 17 columns of GraspNet: score, width, height, depth, rotation by rows,
    translation, object; there x is the approach and y the closing direction. The grasps are of a
    hand with frame G, in ``frame``, one of `FRAMES`; ``source`` is what was perceived.

    Raises:
        OutputError: It cannot be written.
    """
    order = np.argsort(-grasps.score, kind="stable")
    content = {
        "format": "feasigrasp-grasps-1",
        "feasigrasp": __version__,
        "source": str(source),
        "frame": frame,
        "frame_axes": FRAMES[frame],
        "convention": "a pose is the 4 x 4 matrix that takes points from the grasp's frame to this "
        "frame; the grasp's frame: origin between the pads, x the direction in which they close, z "
        "the direction in which the hand approaches, y = z cross x; a width is the distance "
        "between the contacts; metres; best score first",
        "poses": grasps.X_OG[order].round(6).tolist(),
        "widths": grasps.width[order].round(6).tolist(),
        "scores": grasps.score[order].round(6).tolist(),
    }
    if file.suffix.lower() == ".json":
        write_text(file, json.dumps(content) + "\n")
        return
    with replacing(file) as stream:
        if file.suffix.lower() == ".npz":
            arrays: dict[str, Any] = {name: np.array(value) for name, value in content.items()}
            np.savez(stream, **arrays)
            return
        X = grasps.X_OG[order] @ _graspnet_frame()
        fixed = np.full((len(X), 1), 0.02)  # height of the fingers, and how far they reach [m]
        parts = (grasps.score[order, None], grasps.width[order, None], fixed, fixed)
        table = [*parts, X[:, :3, :3].reshape(-1, 9), X[:, :3, 3], 0.0 * fixed]
        np.save(stream, np.concatenate(table, axis=1))


def _graspnet_frame() -> Array:
    """X_GN of the frame of graspnetAPI in ours: x approaches, y closes."""
    return np.array([[0.0, 1.0, 0, 0], [0, 0, 1.0, 0], [1.0, 0, 0, 0], [0, 0, 0, 1.0]])


def read_grasps(file: Path) -> tuple[Array, Array | None]:
    """Grasps of a file of ours or others.

    Args:
        file: JSON or npz as `write_grasps` makes them, an array (n, 4, 4) of poses, or (n, 17) of
            GraspNet. In an npz it is ``poses``, ``grasps`` or ``pred_grasps_cam``, or the only one.

    Returns:
        Poses of frame G, shape (n, 4, 4), and widths, shape (n,), None if they are not there.

    Raises:
        InputError: There is no such file, or none of grasps.
    """
    content = read_json(file) if file.suffix.lower() == ".json" else read_arrays(file)
    names = ("poses", "grasps", "pred_grasps_cam", "arr_0")
    try:
        found = next((content[name] for name in names if name in content), None)
        given = next(iter(content.values())) if found is None else found
        rows = np.asarray(given, dtype=float)
        widths = content.get("widths")
        if rows.ndim == 2 and rows.shape[1] == 17:
            X = np.tile(np.eye(4), (len(rows), 1, 1))
            X[:, :3, :3], X[:, :3, 3] = rows[:, 4:13].reshape(-1, 3, 3), rows[:, 13:16]
            return X @ _graspnet_frame().T, rows[:, 1]
        poses = rows.reshape(-1, 4, 4)
        return poses, None if widths is None else np.asarray(widths, dtype=float).reshape(-1)
    except (ValueError, TypeError, AttributeError, StopIteration) as error:
        raise InputError(f"{file}: {error}; give poses of shape (n, 4, 4) [m]") from error
