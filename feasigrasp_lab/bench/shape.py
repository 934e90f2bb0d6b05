"""``feasigrasp bench shape``: time the distance field beside its peers.

Everything is timed in one go on one thread, so that what is compared ran under the same
conditions; nothing is taken over from an earlier run. `DIR/timings.csv` has all timings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.shape.gpdf_fit import PAPER
from feasigrasp.runs.results.arguments import add_common_arguments, select_objects
from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.measures.timing import (
    Case,
    Timing,
    cpu_time,
    installed,
    report_bench,
    timing_row,
)
from feasigrasp_lab.peers.shape import (
    PRESETS,
    ValidationStep,
    fit_from_points,
    numpy_query,
    partial_cloud,
    potrf_with_copy,
    torch_query,
    whole_fit,
)

#: Nodes of the fields that are timed.
SIZES = (512, 1024)
#: Points at which value and gradient are asked for.
QUERIES = 100_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_shape", objects="mustard_bottle")


def cases(cloud: Array, seed: int) -> Iterator[Case]:
    """What is timed.

    Args:
        cloud: Cloud of one object, shape (n, 3) [m].
        seed: Seed of the queries.
    """
    rng = np.random.default_rng(seed)
    for n in SIZES:
        name, points = f"bench.gpdf_fit_ms.{n}", cloud[farthest_points(cloud, n)]
        yield Case(name, "default", partial(fit_from_points, points))
        factorize, copy = potrf_with_copy(points)
        yield Case(name, "potrf and copy", factorize)
        yield Case(name, "copy", copy)
        if installed("sklearn", "scikit-learn"):
            process = import_module("sklearn.gaussian_process")
            kernel = process.kernels.Matern(PAPER["length_scale"], "fixed", nu=0.5)
            regressor = process.GaussianProcessRegressor(
                kernel, alpha=PAPER["noise_variance"], optimizer=None
            )
            targets = np.ones(len(points))
            yield Case(name, "peer:scikit-learn", partial(regressor.fit, points, targets))
        for preset in PRESETS:
            whole = partial(whole_fit, cloud, preset, n)
            yield Case(f"bench.gpdf_fit_whole_ms.{n}", preset, whole)
            step = ValidationStep.of(cloud, preset, n, seed)
            yield Case(f"bench.validation_ms.{n}", preset, step)
    field = fit_from_points(points)
    low, high = field.bounds + [[-0.1], [0.1]]
    x = rng.uniform(low, high, (QUERIES, 3))
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
    for n in SIZES:
        own, peer = (timings[f"bench.gpdf_fit_ms.{n}", of] for of in ("default", "peer:potrf"))
        ratio = own.value / peer.value
        rows.append(Row.plain(f"bench.gpdf_fit_over_potrf.{n}", "default", ratio, "", own.n))
    report_bench(args, "shape", rows)
    return 0
