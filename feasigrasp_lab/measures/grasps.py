"""Quality measures of proposed and of filtered grasps, on the true mesh."""

from __future__ import annotations

import copy

import numpy as np
from scipy.spatial.transform import Rotation

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet
from feasigrasp.models.grasps.network.contact_features import contact_features
from feasigrasp.models.grasps.network.network import GraspNetwork
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.networks.contact_network import TorchGraspNetwork
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.training.data.grasp_labels import best_labels, find_pairs
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps

#: An object can be grasped if valid grasps start at so many of the points of its true surface.
#: Source: definition.
GRASPABLE = 10


def proposal_measures(
    network: GraspNetwork,
    surface: GraspInput,
    truth: TrueGrasps,
    gripper: ParallelGripper,
    seed: int,
) -> Record:
    """What a network proposes at the points of a surface, beside what is true there.

    Returns:
        Lists: ``contact`` probabilities and ``is_contact`` at all points; at the contacts
        ``width_error`` [m] and ``closing_error`` [deg] to the nearest valid one; at some of them
        ``approach_free``, whether the whole hand is free at the best approach.
    """
    proposals = network.with_gripper(gripper).propose(surface)
    points, normals = surface.points.astype(float), surface.normals.astype(float)
    pairs = find_pairs(truth, points, normals, gripper, np.random.default_rng(seed), 4)
    labels = best_labels(pairs, len(points))
    at = np.flatnonzero(labels.contact)
    # Contacts of a view whose best approach is tried on the true mesh.
    some = at[:: -(-len(at) // 128)] if len(at) else at
    b, width = proposals.closing[some], proposals.width[some]
    z = proposals.approach[some, 0]
    R = np.stack([b, np.cross(z, b), z], axis=2)
    X_OG = se3.make_pose(R, points[some] + 0.5 * width[:, None] * b)
    free = truth.hand_free(X_OG, gripper) | truth.hand_free(X_OG @ FLIP, gripper)
    return {
        "contact": proposals.contact.round(5).tolist(),
        "is_contact": labels.contact.astype(int).tolist(),
        "width_error": [
            round(float(np.abs(pairs.width[pairs.point == i] - proposals.width[i]).min()), 6)
            for i in at
        ],
        "closing_error": pairs.closing_error_deg(at, proposals.closing[at]).round(4).tolist(),
        "approach_free": free.astype(int).tolist(),
    }


def set_measures(grasps: GraspSet, truth: TrueGrasps, gripper: ParallelGripper) -> Record:
    """How many grasps of a filtered set are truly valid, and which.

    Returns:
        ``grasps``, their number; ``valid``, how many are antipodal and free on the true mesh;
        ``antipodal`` and ``free`` alone; ``top_valid``, whether the best one is (None without one);
        lists ``score`` and ``is_valid``.
    """
    antipodal = truth.truly_antipodal(grasps.X_OG, gripper.max_opening)
    free = truth.hand_free(grasps.X_OG, gripper)
    valid = antipodal & free
    return {
        "grasps": len(grasps),
        "valid": int(valid.sum()),
        "antipodal": int(antipodal.sum()),
        "free": int(free.sum()),
        "top_valid": int(valid[0]) if len(valid) else None,
        "score": grasps.score.round(4).tolist(),
        "is_valid": valid.astype(int).tolist(),
    }


def is_graspable(truth: TrueGrasps, surface: GraspInput, gripper: ParallelGripper) -> bool:
    """Whether the true surface has grasps for the hand, see `GRASPABLE`."""
    points, normals = surface.points.astype(float), surface.normals.astype(float)
    pairs = find_pairs(truth, points, normals, gripper, np.random.default_rng(0))
    return len(np.unique(pairs.point)) >= GRASPABLE


def equivariance_error(network: TorchGraspNetwork, surface: GraspInput, seed: int) -> float:
    """Largest change of a float64 network's answers, once a motion of the object is undone.

    Over all probabilities, widths [m] and components of unit vectors; the object is turned, moved
    and its points are shuffled.
    """
    double = type(network).of(copy.deepcopy(network.network).double())
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=rng).as_matrix()
    p, order = rng.normal(size=3), rng.permutation(len(surface))
    points, normals = surface.points.astype(float), surface.normals.astype(float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    scalars = surface.scalars.astype(float)
    still = double.propose_at(contact_features(points, normals, scalars))
    moved = double.propose_at(
        contact_features((points @ R.T + p)[order], (normals @ R.T)[order], scalars[order])
    )
    numbers = ("contact", "width", "width_deviation", "approach_score")
    errors = [getattr(still, name)[order] - getattr(moved, name) for name in numbers]
    errors.append(still.closing[order] @ R.T - moved.closing)
    # Between modes that score the same, rounding decides which comes first.
    # Modes of approach whose scores differ by less are in any order.
    clear = np.abs(np.diff(moved.approach_score, axis=1)).min(axis=1, initial=1.0) > 1e-7
    errors.append((still.approach[order] @ R.T - moved.approach)[clear])
    return max(float(np.abs(error).max(initial=0.0)) for error in errors)
