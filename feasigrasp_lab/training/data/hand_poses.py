"""What grasp diffusion learns from: valid hand poses and signed distances, beside the same clouds.

Made of the shards of ``feasigrasp train sampler-data``: the clouds are the same, and the poses are
grasps that the same labels tell of, put exactly on the true mesh. Only the shapes of our own stream
can be made again from what a shard says of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.errors import MeshError
from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import FLIP, grasp_frames
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.results.finished import read_shard, write_arrays
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import make_shape

#: Hand poses and signed distances that are kept of each example; with fewer valid poses than the
#: last, an example is left out.
POSES, DISTANCES, LEAST = 192, 512, 16
#: What is read of a shard.
_ENTRIES = (
    *("points", "normals", "contact", "closing", "width", "across", "free"),
    *("family", "object_seed"),
)
#: Candidates that are tried for each pose that is kept.
_TRIES = 3
#: Distances are taken so near to the surface [m], and in a box that is larger by so much [m].
_NEAR, _BESIDE = 0.01, 0.08


def write_hand_poses(filename: Path, number: int, *, shards: list[Path]) -> bool:
    """Writes the examples of one shard of the sampler's data.

    Args:
        filename: Where to: ``points`` and ``normals`` (N, n, 3), ``X_OG`` (N, POSES, 4, 4),
            ``places`` (N, DISTANCES, 3) and their ``distance`` (N, DISTANCES), all in O [m], and
            ``family`` (N,).
        number: Of the shard; seeds what is drawn.
        shards: All of them.

    Returns:
        Whether there is any example with grasps.

    Raises:
        MeshError: The shard's objects are no shapes of our own.
    """
    data = read_shard(shards[number], _ENTRIES)
    rng = np.random.default_rng([number, 7])
    found: dict[str, list[Any]] = {
        name: [] for name in ("points", "normals", "X_OG", "places", "distance", "family")
    }
    truths: dict[tuple[str, int], TrueGrasps] = {}
    for row, family in enumerate(data["family"]):
        key = str(family), int(data["object_seed"][row])
        if key not in truths:
            truths[key] = _truth(*key)
        truth = truths[key]
        example = {name: data[name][row] for name in _ENTRIES[:-2]}
        poses = valid_poses(truth, example, rng)
        if len(poses) < LEAST:
            continue
        places = _places(truth, rng)
        found["X_OG"].append(np.resize(poses, (POSES, 4, 4)).astype(np.float32))
        found["places"].append(places.astype(np.float32))
        found["distance"].append(truth.surface.signed_distance(places).astype(np.float32))
        for name in ("points", "normals"):
            found[name].append(example[name].astype(np.float32))
        found["family"].append(family)
    if found["family"]:
        write_arrays(filename, {name: np.stack(parts) for name, parts in found.items()})
    return bool(found["family"])


def valid_poses(truth: TrueGrasps, example: dict[str, Any], rng: np.random.Generator) -> Array:
    """Some of the valid hand poses that an example's labels tell of, (n, 4, 4), n <= `POSES`.

    Args:
        truth: The true object.
        example: One row of a shard of ``train sampler-data``.
        rng: Draws which.
    """
    point, turn = np.nonzero(example["free"] & example["contact"][:, None])
    if len(point) == 0:
        return np.zeros((0, 4, 4))
    some = rng.integers(len(point), size=_TRIES * POSES)
    point, turn = point[some], turn[some]
    b, u = (example[name][point].astype(float) for name in ("closing", "across"))
    angle = (2.0 * np.pi / example["free"].shape[1] * turn)[:, None]
    z = np.cos(angle) * u + np.sin(angle) * np.cross(b, u)
    contact, _ = truth.closest(example["points"][point].astype(float))
    middle = contact + 0.5 * example["width"][point, None].astype(float) * b
    X_OG = grasp_frames(middle, b, z[:, None])[:, 0]
    flipped = rng.random(len(X_OG)) < 0.5  # the camera may be on either side
    X_OG[flipped] = X_OG[flipped] @ FLIP
    return X_OG[truth.valid(X_OG, ParallelGripper())][:POSES]


def _places(truth: TrueGrasps, rng: np.random.Generator) -> Array:
    """Places near the surface and round the object, half of each, shape (DISTANCES, 3) [m]."""
    half = DISTANCES // 2
    near = truth.samples[rng.integers(len(truth.samples), size=half)]
    near = near + rng.normal(0.0, _NEAR, (half, 3))
    lower, upper = truth.samples.min(axis=0) - _BESIDE, truth.samples.max(axis=0) + _BESIDE
    return np.concatenate([near, rng.uniform(lower, upper, (half, 3))])


def _truth(family: str, seed: int) -> TrueGrasps:
    try:
        return TrueGrasps(make_shape(family, seed).mesh)
    except MeshError as error:
        raise MeshError(
            f"{error}: grasp diffusion learns on our own shapes; make them with `feasigrasp train "
            "sampler-data` without --meshes and --acronym"
        ) from error
