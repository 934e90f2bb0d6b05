"""``feasigrasp bench sampler``: time the pipeline from a cloud to grasps, on one thread.

One noisy view of an object, as the depth camera gives it, is smoothed, completed by a field of 512
points, shown to the network, and its grasps are filtered: `bench.perception_ms` is all of that, the
parts are timed on their own as well. Preset ``peer:torch`` of the forward pass is the same network
and weights in torch, without what is done with its answers. Of the baseline, the energy's gradient
at one pose and 100 samples are timed. Nothing is taken over from an earlier run.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import torch

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn
from feasigrasp.models.grasps.network.contact_features import contact_features
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp_lab.baselines.diffusion_sampler import DiffusionSampler
from feasigrasp_lab.baselines.grasp_diffusion import load_grasp_diffusion
from feasigrasp_lab.paper.grasp_network import torch_heads, trained_network
from feasigrasp_lab.results.arguments import add_common_arguments, select_objects
from feasigrasp_lab.results.timing import Case, report_bench, time_cases
from feasigrasp_lab.training.data.views import PartialView, ViewedObject, fused, turning_views

#: Points of the field and of the network's input; points of the forward pass alone. Source:
#: guessed.
POINTS, NETWORK_POINTS = 512, 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_sampler", objects="mustard_bottle")


def cases(view: PartialView) -> Iterator[Case]:
    """What is timed on one view."""
    network = trained_network("default")
    sampler = NetworkSampler(network=network, n_points=POINTS)
    cloud = fused([view])
    field = complete_shape(cloud, max_points=POINTS)
    surface = grasp_input(field, POINTS)
    forward = f"bench.network_forward_ms.{NETWORK_POINTS}"
    for preset in ("default", "paper"):
        other, large = trained_network(preset), grasp_input(field, NETWORK_POINTS)
        yield Case(f"bench.network_ms.{NETWORK_POINTS}", preset, partial(other.propose, large))
        features = contact_features(large.points, large.normals, large.scalars)
        yield Case(forward, preset, partial(other.propose_at, features))
    yield Case(forward, "peer:torch", partial(torch_heads, network.network, features))
    for preset, used in (("default", sampler), ("antipodal", AntipodalSampler())):
        yield Case("bench.perception_ms", preset, partial(cloud_to_grasps, view, used))
    X_OG, width, prior = sampler.candidates(field)
    baseline = DiffusionSampler()
    diffused = load_grasp_diffusion().at(grasp_input(field, baseline.n_points))
    gradient = partial(diffused.gradient, X_OG[:1])
    yield Case("bench.diffusion_gradient_hz", "default", gradient)
    rng, count = np.random.default_rng(0), baseline.n_samples
    samples = partial(diffused.sample, count, rng)
    yield Case(f"bench.diffusion_samples_s.{count}", "default", samples)
    parts: dict[str, Callable[[], object]] = {
        "smoothing": lambda: fused([view]),
        "fit": lambda: complete_shape(cloud, max_points=POINTS),
        "completion": field.surface,
        "input": lambda: grasp_input(field, POINTS),
        "network": lambda: network.propose(surface),
        "candidates": lambda: sampler.candidates(field),
        "filter": lambda: filter_grasps(field, X_OG, width, sampler.gripper, prior=prior),
    }
    for part, function in parts.items():
        yield Case(f"bench.perception_part_ms.{part}", "default", function)


def cloud_to_grasps(view: PartialView, sampler: GraspSamplerFn) -> object:
    """Everything between a camera's points and filtered grasps."""
    return sampler(complete_shape(fused([view]), max_points=POINTS))


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    viewed = ViewedObject(load_object(next(iter(select_objects(args.objects).values()))))
    rng = np.random.default_rng(args.seed)
    view = viewed.view(turning_views(rng, viewed.center, 1)[0], rng)
    torch.set_num_threads(1)
    rows = time_cases(cases(view), 0.5 if args.quick else 3.0)
    report_bench(args, "sampler", rows)
    return 0
