"""What `bench_shape` times: clouds, fits, the paper's validation step, and peers for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh
from scipy.linalg import lapack
from scipy.spatial.distance import cdist

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.completion import Preset
from feasigrasp.models.shape.covariance import gram_lower
from feasigrasp.models.shape.gpdf_fit import PAPER, Gpdf, fit_field, fit_gpdf

#: Where the camera looks from, relative to the object's centre [m].
CAMERA = np.array([0.35, 0.2, 0.3])
#: Points of a cloud, as a camera half a metre away sees them, and their noise [m].
CLOUD_POINTS, DEPTH_NOISE = 4000, 0.001
#: The validation step: grasps, gripper points, points with normals, steps of the refinement.
GRASPS, GRIPPER_POINTS, NORMALS, STEPS = 512, 64, 1024, 5
#: A hand whose points come closer than this collides [m].
MARGIN = 0.003
#: Keyword arguments of `fit_gpdf` by preset.
PRESETS: dict[str, dict[str, Any]] = {"paper": {**PAPER}, "default": {}}


def partial_cloud(name: str, seed: int) -> Array:
    """Noisy points of the side of an object that faces the camera, (CLOUD_POINTS, 3) [m]."""
    obj = load_object(name)
    mesh = trimesh.Trimesh(obj.vertices, obj.faces)
    points, faces = trimesh.sample.sample_surface(mesh, 8 * CLOUD_POINTS, seed=seed)
    to_camera = CAMERA + mesh.bounds.mean(axis=0) - points
    facing = np.einsum("ni,ni->n", mesh.face_normals[faces], to_camera) > 0.0
    seen = np.asarray(points[facing][:CLOUD_POINTS], dtype=float)
    return seen + np.random.default_rng(seed).normal(scale=DEPTH_NOISE, size=seen.shape)


def whole_fit(cloud: Array, preset: str, nodes: int) -> Gpdf:
    """Selection, normals and fit, from a cloud; at most so many nodes, offset points included."""
    points = nodes if preset == Preset.PAPER else 3 * nodes // 5
    return fit_gpdf(cloud, max_points=points, viewpoint=CAMERA, **PRESETS[preset])


def fit_from_points(points: Array) -> Gpdf:
    """The fit alone: Gram matrix, Cholesky factor, weights."""
    return fit_field(
        points,
        np.ones(len(points)),
        points=points,
        bounds=np.stack([points.min(axis=0), points.max(axis=0)]),
        length_scale=PAPER["length_scale"],
        noise_variance=PAPER["noise_variance"],
    )


@dataclass(frozen=True, eq=False)
class ValidationStep:
    """All that the paper asks of a field before grasps are sent on, as one call.

    The fit (with the selection of its nodes), the projection of 512 grid points onto the surface
    with their variance, the collision test of 512 grasps with 64 gripper points each, and refined
    normals at 1024 points.

    Attributes:
        cloud: Cloud of one object, shape (n, 3) [m].
        preset: Key of `PRESETS`.
        nodes: Most nodes of the field.
        X_OG: Grasps, shape (512, 4, 4).
        hand: Points on the gripper, shape (64, 3) [m].
        at: Where normals are wanted, shape (1024, 3) [m].
    """

    cloud: Array
    preset: str
    nodes: int
    X_OG: Array
    hand: Array
    at: Array

    @classmethod
    def of(cls, cloud: Array, preset: str, nodes: int, seed: int) -> ValidationStep:
        """A step with unfiltered grasps of the object, points near it, and its sampler's hand."""
        sampler = AntipodalSampler(n_candidates=GRASPS)
        grasps, _, _ = sampler.candidates(whole_fit(cloud, preset, nodes))
        every = sampler.gripper.surface_points(sampler.gripper.max_opening)
        rng = np.random.default_rng(seed)
        at = cloud[rng.choice(len(cloud), NORMALS)] + rng.normal(scale=0.01, size=(NORMALS, 3))
        hand = every[farthest_points(every, GRIPPER_POINTS)]
        return cls(cloud, preset, nodes, np.resize(grasps, (GRASPS, 4, 4)), hand, at)

    def __call__(self) -> tuple[Array, Mask, Array]:
        """Variance of the completed surface, which grasps collide, refined normals."""
        field = whole_fit(self.cloud, self.preset, self.nodes)
        collides = field.clearance(self.X_OG, self.hand, MARGIN, MARGIN)[0] < MARGIN
        return field.completion.variance, collides, field.refine(self.at, STEPS)[2]


def potrf_with_copy(nodes: Array) -> tuple[Callable[[], object], Callable[[], object]]:
    """LAPACK's Cholesky factorization of the Gram matrix in a copy, and the copying alone."""
    centred = np.ascontiguousarray((nodes - nodes.mean(axis=0)).T)
    noise = np.full(len(nodes), PAPER["noise_variance"])
    gram = np.array(gram_lower(centred, PAPER["length_scale"], noise).T, order="F")
    gram[np.triu_indices(len(gram), 1)] = 0.0
    scratch = np.empty_like(gram, order="F")

    def copy() -> object:
        scratch[:] = gram
        return scratch

    def factorize() -> object:
        return lapack.dpotrf(copy(), lower=1, overwrite_a=1, clean=0)

    return factorize, copy


def numpy_query(field: Gpdf) -> Callable[[Array], tuple[Array, Array]]:
    """Value and gradient as one writes them in NumPy: a distance matrix and two products."""
    nodes, alpha = field.nodes.T + field.center, field.alpha
    length_scale = field.length_scale
    ones = np.concatenate([nodes, np.ones((len(nodes), 1))], axis=1)

    def query(x: Array) -> tuple[Array, Array]:
        r = cdist(x, nodes)
        k = np.exp(r / -length_scale) * alpha
        o = k.sum(axis=1)
        sums = (k / np.maximum(r, 1e-15)) @ ones
        return -length_scale * np.log(o), (x * sums[:, 3:] - sums[:, :3]) / o[:, None]

    return query


def torch_query(field: Gpdf) -> Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]:
    """The same in torch, float32; distances by a matrix product, the quicker of its two ways."""
    nodes = torch.as_tensor(field.nodes.T + field.center, dtype=torch.float32)
    alpha = torch.as_tensor(np.array(field.alpha), dtype=torch.float32)
    length_scale = field.length_scale
    ones = torch.cat([nodes, torch.ones(len(nodes), 1)], dim=1)

    def query(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        r = torch.cdist(x, nodes, compute_mode="use_mm_for_euclid_dist")
        k = torch.exp(r / -length_scale) * alpha
        o = k.sum(dim=1)
        sums = (k / r.clamp(min=1e-9)) @ ones
        return -length_scale * torch.log(o), (x * sums[:, 3:] - sums[:, :3]) / o[:, None]

    return query
