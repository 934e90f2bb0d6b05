"""Fits a Gaussian process distance field to a partial cloud (Le Gentil et al. 2024).

A Gaussian process with the Matern-1/2 kernel ``k(r) = exp(-r / l)`` interpolates occupancy 1 on
the observed points; because the kernel inverts in closed form, occupancy becomes distance:
``o(x) = k(x, X) (K + s2 I)^-1 y`` and ``d(x) = -l ln o(x)`` (Choi & Figueroa, arXiv 2311.02576,
"Shape Completion with Distance Field Refinement"). Inside the object o > 1 and d < 0, so o is
never clamped at 1.

Deviation from the paper: beside some of the points, values at ``+-surface_offset`` along the
normal, ``y = exp(-+h / l)``, give the process the inside. Without them one third of the
inside has the wrong sign for a single view. ``surface_offset=None`` gives the paper's field.
"""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.clouds.checks import check_fit, checked_cloud, directions_to_camera
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.quantities import CLOUD, VIEW, Count, Positive
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.node_sums import LOG2_E, MAX_NODE_RADIUS, gram_lower


@checked(PointCloudError)
def fit_gpdf(
    points: Annotated[ArrayLike, CLOUD],
    *,
    length_scale: Positive = 0.3,
    noise_variance: Positive = 0.0025,
    surface_offset: Positive | None = 0.002,
    max_points: Count = 320,
    viewpoint: Annotated[ArrayLike, VIEW] | None = None,
    damped: bool = True,
) -> Gpdf:
    """Fits the distance field to a point cloud of one object.

    Args:
        points: Cloud, shape (n, 3) [m], in any frame; the field lives in the same frame.
        length_scale: l of the kernel [m]; large values complete unseen parts, small ones do not.
        noise_variance: s2; 0.0025 suits 1 mm of depth noise, 0.01 suits 3 mm.
        surface_offset: h of the values beside a third of the points [m]; None for the paper's
            field, which has none.
        max_points: Surface points kept, chosen by farthest-point selection, corners first (no
            random numbers).
        viewpoint: Where the camera was, shape (3,) [m], or the direction from each point to its
            camera, shape (n, 3). Orients the normals; without it they point away from the centroid.
        damped: Whether ``Gpdf.refine`` takes damped Newton steps; False for the paper's steps.

    Raises:
        PointCloudError: If the cloud has the wrong shape, too few points, NaN or infinity, no
            extent or an absurd one, or if a parameter is out of range.
    """
    # Above this many points the cloud is thinned evenly before farthest-point selection.
    max_candidates = 2048
    cloud = checked_cloud(points)
    check_fit(length_scale, surface_offset, max_points)
    bounds = np.stack([cloud.min(axis=0), cloud.max(axis=0)])
    directions = None if viewpoint is None else directions_to_camera(cloud, viewpoint)

    if len(cloud) > max_candidates:
        even = np.linspace(0, len(cloud) - 1, max(max_candidates, max_points)).astype(int)
        cloud = cloud[even]
        directions = None if directions is None else directions[even]
    count = min(max_points, len(cloud))
    # One chosen point in this number is one that sticks out: the corners.
    outward = count // 8
    chosen = farthest_points(cloud, count, outward)
    surface = cloud[chosen]

    nodes, targets = surface, np.ones(len(surface))
    if surface_offset is not None:
        # Those chosen early cover the cloud evenly; at corners there is no normal.
        beside = chosen[outward : outward - (-count // 3)]
        towards = None if directions is None else directions[beside]
        at, normals = _outward_normals(cloud, beside, towards)
        offset = surface_offset * normals
        nodes = np.concatenate([surface, at + offset, at - offset])
        value = np.exp(-surface_offset / length_scale)
        targets = np.concatenate([targets, np.full(len(at), value), np.full(len(at), 1.0 / value)])
    return fit_field(
        nodes,
        targets,
        points=surface,
        bounds=bounds,
        length_scale=length_scale,
        noise_variance=noise_variance,
        damped=damped,
    )


def fit_field(
    nodes: ArrayLike,
    targets: ArrayLike,
    *,
    points: ArrayLike,
    bounds: ArrayLike,
    length_scale: float,
    noise_variance: float | ArrayLike,
    damped: bool = True,
) -> Gpdf:
    """Fits the process to occupancies at given nodes: the lower level of ``fit_gpdf``.

    Use it where the nodes are not just observed points, for example with values in free space,
    ``exp(-dist / l)`` at ``dist`` from the surface. Solves ``(K + diag(s2)) alpha = y``. The
    field is in the frame of the nodes.

    Args:
        nodes: Where the occupancy is given, shape (k, 3) [m].
        targets: The occupancy y there, shape (k,): 1 on the surface, less outside, more inside.
        points: Surface points among them, shape (n, 3) [m]; what ``Gpdf.points`` hands on.
        bounds: Lower and upper corner of the observed cloud, shape (2, 3) [m].
        length_scale: l of the kernel [m].
        noise_variance: s2 of every node, or one per node, shape (k,).
        damped: Whether ``Gpdf.refine`` takes damped Newton steps.

    Raises:
        PointCloudError: If the kernel matrix is not positive definite, or if the nodes reach
            hundreds of length scales from the centre of the points.
    """
    surface = np.array(points, dtype=float)
    center = surface.mean(axis=0)
    centred = _centred(nodes, center, length_scale)
    y = np.array(targets, dtype=float)
    noise = np.broadcast_to(np.asarray(noise_variance, dtype=float), len(y)).copy()
    factor = _factorized(gram_lower(centred, length_scale, noise).T, noise)
    return Gpdf(
        points=surface,
        bounds=np.array(bounds, dtype=float),
        length_scale=float(length_scale),
        noise_variance=noise,
        center=center,
        nodes=centred,
        alpha=np.asarray(lapack.dpotrs(factor, y, lower=1)[0]),
        cholesky=factor,
        damped=damped,
    )


def _centred(nodes: ArrayLike, center: Array, length_scale: float) -> Array:
    """Nodes relative to the centre, shape (3, k)."""
    centred = np.ascontiguousarray((np.asarray(nodes, dtype=float) - center).T)
    radius = float(np.sqrt(np.einsum("ij,ij->j", centred, centred).max()))
    if not radius * LOG2_E / length_scale <= MAX_NODE_RADIUS:
        raise PointCloudError(
            f"nodes reach {radius:.3g} m from the centre, {radius / length_scale:.0f} times "
            f"length_scale ({length_scale:g} m), and at most {MAX_NODE_RADIUS / LOG2_E:.0f} times "
            "can be computed; raise length_scale, and look for NaN among the nodes"
        )
    return centred


def _factorized(gram: Array, noise: Array) -> Array:
    """The Cholesky factor, made in the lower triangle of ``gram`` (Fortran order)."""
    factor, info = lapack.dpotrf(gram, lower=1, overwrite_a=1, clean=0)
    if info != 0:
        raise PointCloudError(
            f"the kernel matrix is not positive definite (LAPACK info {info}); "
            f"raise noise_variance (now {noise.min():g} at least)"
        )
    return np.asarray(factor)


def _outward_normals(
    cloud: Array, indices: Indices, towards_camera: Array | None
) -> tuple[Array, Array]:
    """Some points of a cloud (n, 3) and outward unit normals there, by principal components.

    A normal is turned to the camera's side, or, without a camera, away from the centroid. Where
    that is undecided (normal nearly perpendicular to the reference) the point is left out:
    a normal with the wrong sign does more harm than none.
    """
    at = cloud[indices]
    # Points that a plane is fitted to for a normal.
    _, near = cKDTree(cloud).query(at, k=min(20, len(cloud)))
    patch = cloud[near]
    patch = patch - patch.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("mki,mkj->mij", patch, patch))
    normals = vectors[:, :, 0]
    reference = at - cloud.mean(axis=0) if towards_camera is None else towards_camera
    length = np.maximum(np.linalg.norm(reference, axis=1), 1e-12)
    cosine = np.einsum("mi,mi->m", normals, reference) / length
    # Below this |cosine| between a normal and its reference direction its sign is a guess.
    reliable = np.abs(cosine) > 0.15
    return at[reliable], (normals * np.sign(cosine)[:, None])[reliable]
