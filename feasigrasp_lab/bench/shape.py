"""``feasigrasp bench shape``: time the distance field beside its peers.

Everything is timed in one go on one thread; `DIR/timings.csv` has all timings.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.gpdf import Gpdf, fit_field
from feasigrasp.models.shape.node_sums import gram_lower
from feasigrasp_lab.paper.field import PAPER
from feasigrasp_lab.results.arguments import add_common_arguments, select_objects
from feasigrasp_lab.results.timing import Case, Timing, cpu_time, report_bench, timing_row

#: Nodes of the fields that are timed. Source: guessed.
SIZES = (512, 1024)


def partial_cloud(name: str, seed: int) -> Array:
    """Noisy points of the side of an object that faces a camera, (4000, 3) [m]."""
    # Points of a cloud, as a camera half a metre away sees them, and their noise [m]; where that
    # camera is, relative to the object's centre [m].
    cloud_points, depth_noise, camera = 4000, 0.001, np.array([0.35, 0.2, 0.3])
    obj = load_object(name)
    mesh = trimesh.Trimesh(obj.vertices, obj.faces)
    points, faces = trimesh.sample.sample_surface(mesh, 8 * cloud_points, seed=seed)
    to_camera = camera + mesh.bounds.mean(axis=0) - points
    facing = np.einsum("ni,ni->n", mesh.face_normals[faces], to_camera) > 0.0
    seen = np.asarray(points[facing][:cloud_points], dtype=float)
    return seen + np.random.default_rng(seed).normal(scale=depth_noise, size=seen.shape)


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_shape", objects="mustard_bottle")


def cases(cloud: Array, seed: int) -> Iterator[Case]:
    """What is timed on a cloud (n, 3) [m] of one object, at random queries."""
    rng = np.random.default_rng(seed)
    for n in SIZES:
        name, points = f"bench.gpdf_fit_ms.{n}", cloud[farthest_points(cloud, n)]
        yield Case(name, "default", partial(fit_from_points, points))
        factorize, copy = potrf_with_copy(points)
        yield Case(name, "potrf and copy", factorize)
        yield Case(name, "copy", copy)
    field = fit_from_points(points)
    low, high = field.bounds + [[-0.1], [0.1]]
    # Points at which value and gradient are asked for.
    x = rng.uniform(low, high, (100_000, 3))
    single = torch.as_tensor(x, dtype=torch.float32)
    for preset, query in (
        ("default", partial(field.distance_and_gradient, x)),
        ("peer:numpy", partial(_in_parts, numpy_query(field), x)),
        ("peer:torch", partial(_in_parts, torch_query(field), single)),
    ):
        yield Case("bench.gpdf_query_ms", preset, query)


def _in_parts(query: Callable, x: NDArray | torch.Tensor) -> list:  # type: ignore[type-arg]
    """Peers build m x n matrices: a thousand queries at a time keep them in the cache."""
    return [query(x[i : i + 1000]) for i in range(0, len(x), 1000)]


def timed(cloud: Array, seed: int, seconds: float) -> dict[tuple[str, str], Timing]:
    """Times all cases, by row name and preset; LAPACK's factorization without the copying."""
    found = {
        (name, preset): cpu_time(function, seconds)
        for name, preset, function, _ in tqdm(cases(cloud, seed), desc="shape", unit="case")
    }
    for n in SIZES:
        name = f"bench.gpdf_fit_ms.{n}"
        both, copy = found.pop((name, "potrf and copy")), found.pop((name, "copy")).value
        found[name, "peer:potrf"] = Timing(
            both.value - copy, both.low - copy, both.high - copy, both.n
        )
    return found


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    name = next(iter(select_objects(args.objects).values()))
    torch.set_num_threads(1)
    with threadpool_limits(1):
        timings = timed(partial_cloud(name, args.seed), args.seed, 0.2 if args.quick else 2.0)
    rows = [timing_row(name, preset, t) for (name, preset), t in sorted(timings.items())]
    report_bench(args, "shape", rows)
    return 0
