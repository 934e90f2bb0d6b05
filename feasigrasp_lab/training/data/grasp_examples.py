"""Training examples of the grasp network: inputs and labels of one object.

Inputs are made as they are at run time: a noisy depth camera looks at the object one to three times
while it turns, the views are fused with the tracker's error, and the distance field completes the
surface. One in five is the true surface instead. Labels come from the true mesh.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from feasigrasp.errors import PointCloudError
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.grasps.network.surface_input import (
    MAX_CHORD,
    MAX_GRASP,
    SCALARS,
    GraspInput,
    grasp_input,
)
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf, predicted_deviation
from feasigrasp_lab.training.data.grasp_labels import find_labels
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.views import PartialView, ViewedObject, fused, turning_views

Example = dict[str, Any]

#: Points of an input. Source: layout: input of the network.
POINTS = 512
#: Standard deviation of the tracked pose in every other fusion of several views: [m] and [rad].
#: Source: guessed.
TRACKING = (0.002, float(np.deg2rad(1.0)))
#: Labels that are stored in single precision.
_SINGLE = ("width", "closing", "across")


def fuse_and_complete(views: Sequence[PartialView]) -> Gpdf:
    """Views become a distance field, as perception does it by default."""
    # Points that the field is fitted to, perception's default.
    return complete_shape(fused(views), max_points=320)


def completed_input(
    viewed: ViewedObject, n_views: int, rng: np.random.Generator
) -> GraspInput | None:
    """The input that random views of an object give; None if it can hardly be seen.

    Args:
        viewed: The object.
        n_views: Number of views, while it turns.
        rng: Draws camera poses, sensor noise and errors of the tracker.
    """
    tracking = TRACKING if n_views > 1 and rng.random() < 0.5 else (0.0, 0.0)
    # Times that a view is drawn anew if it shows too little.
    for _ in range(4):
        try:
            cameras = turning_views(rng, viewed.center, n_views)
            field = fuse_and_complete([viewed.view(X_OC, rng, tracking) for X_OC in cameras])
        except PointCloudError:
            continue
        made = grasp_input(field, POINTS)
        rows = np.resize(np.arange(len(made)), POINTS)  # if there are fewer, some are there twice
        return GraspInput(made.points[rows], made.normals[rows], made.scalars[rows])
    return None


def true_input(truth: TrueGrasps, rng: np.random.Generator) -> GraspInput:
    """The input that a perfect reconstruction of an object would give."""
    mesh = truth.mesh
    samples, faces = trimesh.sample.sample_surface(mesh, 4 * POINTS, seed=rng)
    chosen = farthest_points(np.ascontiguousarray(samples), POINTS)
    points = np.asarray(samples[chosen], dtype=float)
    normals = np.asarray(mesh.face_normals[faces[chosen]])
    length, far = truth.cast(points - 1e-5 * normals, -normals)
    # From beyond the opening back: the outermost face, unless that place is inside the object.
    back, outer = truth.cast(points - MAX_GRASP * normals, normals)
    several = (MAX_GRASP - back > length) & (np.einsum("ij,ij->i", outer, normals) < 0.0)
    length, far = (
        np.where(several, MAX_GRASP - back, length),
        np.where(several[:, None], outer, far),
    )
    # Chords of true surfaces shorter than this are grazing hits [m].
    hit = (length > 1e-3) & (length <= MAX_CHORD)
    confidence = float(predicted_deviation(0.0))
    scalars = np.zeros((POINTS, len(SCALARS)))
    scalars[:, 0] = confidence
    scalars[hit, 1] = length[hit]
    scalars[hit, 2] = np.einsum("ij,ij->i", normals[hit], far[hit])
    scalars[hit, 3] = confidence
    return GraspInput(points, normals, scalars)  # type: ignore[arg-type]


def object_examples(
    obj: RigidObject, family: str, seed: int, inputs: int, rng: np.random.Generator
) -> list[Example]:
    """Examples of one object.

    Args:
        obj: The object.
        family: What it is, written beside.
        seed: Its seed, written beside.
        inputs: Number of examples; fewer if it cannot be seen.
        rng: Draws everything.
    """
    # Share of the inputs that are true surfaces; of the others, shares with 1, 2 and 3 views.
    true_share, view_shares = 0.2, (0.5, 0.2, 0.3)
    viewed, truth = ViewedObject(obj), TrueGrasps(obj.mesh)
    examples = []
    for _ in range(inputs):
        true = rng.random() < true_share
        n_views = 0 if true else 1 + int(rng.choice(3, p=view_shares))
        made = true_input(truth, rng) if true else completed_input(viewed, n_views, rng)
        if made is None:
            continue
        surface = made.points.astype(float), made.normals.astype(float)
        labels = find_labels(truth, *surface, ParallelGripper(), rng)._asdict()
        labels |= {name: labels[name].astype(np.float32) for name in _SINGLE}
        about = {"family": family, "object_seed": seed, "n_views": n_views, "true_surface": true}
        seen = {"points": made.points, "normals": made.normals, "scalars": made.scalars}
        examples.append(seen | labels | about)
    return examples


def stacked(examples: Sequence[Example]) -> dict[str, NDArray[Any]]:
    """Examples as the arrays of one shard, one row per example."""
    return {name: np.stack([np.asarray(e[name]) for e in examples]) for name in examples[0]}
