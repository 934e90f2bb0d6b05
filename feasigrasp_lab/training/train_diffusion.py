"""``feasigrasp train diffusion``: train the grasp-diffusion baseline on the sampler's data.

From the shards of ``feasigrasp train sampler-data`` it makes valid hand poses, grasps of the same
labels put exactly on the true mesh, and signed distances, in shards that are kept. On them it
trains `feasigrasp_lab.baselines.diffusion_energy` by denoising score matching on SE(3). Families of
shapes that are held out validate; start the same command again to resume.
"""

import argparse
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from feasigrasp.errors import MeshError
from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.grasp_set import FLIP, grasp_frames
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.baselines.diffusion_energy import LENGTH, PoseEnergy, standard_deviation
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.results.finished import make_shards, read_shard, write_arrays
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import make_shape
from feasigrasp_lab.training.diffusion_batches import (
    Batch,
    PoseExamples,
    drawn_batch,
    load_pose_examples,
)
from feasigrasp_lab.training.loop import (
    TrainingRun,
    add_data_argument,
    add_evaluation_arguments,
    add_loop_arguments,
    data_files,
    rows_of_step,
    without_denormals,
)

#: Hand poses and signed distances that are kept of each example; with fewer valid poses than the
#: last, an example is left out. Source: guessed.
POSES, DISTANCES, LEAST = 192, 512, 16
#: What is read of a shard.
_ENTRIES = (
    *("points", "normals", "contact", "closing", "width", "across", "free"),
    *("family", "object_seed"),
)


def write_hand_poses(filename: Path, number: int, *, shards: list[Path]) -> None:
    """Writes the examples of one shard of the sampler's data, if any of them has grasps.

    Args:
        filename: Where to: ``points`` and ``normals`` (N, n, 3), ``X_OG`` (N, POSES, 4, 4),
            ``places`` (N, DISTANCES, 3) and their ``distance`` (N, DISTANCES), all in O [m], and
            ``family`` (N,).
        number: Of the shard; seeds what is drawn.
        shards: All of them.

    Raises:
        MeshError: The shard's objects are no shapes of our own.
    """
    data = read_shard(shards[number], _ENTRIES)
    rng = np.random.default_rng([number, 7])
    found: dict[str, list[Any]] = {
        name: [] for name in ("points", "normals", "X_OG", "places", "distance", "family")
    }
    for row, family in enumerate(data["family"]):
        truth = _truth(str(family), int(data["object_seed"][row]))
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


def valid_poses(truth: TrueGrasps, example: dict[str, Any], rng: np.random.Generator) -> Array:
    """Some of the valid hand poses in an example's labels, (n, 4, 4), n <= `POSES`.

    Args:
        truth: The true object.
        example: One row of a shard of ``train sampler-data``.
        rng: Draws which.
    """
    point, turn = np.nonzero(example["free"] & example["contact"][:, None])
    if len(point) == 0:
        return np.zeros((0, 4, 4))
    # Candidates that are tried for each pose that is kept.
    some = rng.integers(len(point), size=3 * POSES)
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
    # Distances are taken so near to the surface [m], and in a box that is larger by so much [m].
    near_surface, beyond_box = 0.01, 0.08
    half = DISTANCES // 2
    near = truth.samples[rng.integers(len(truth.samples), size=half)]
    near = near + rng.normal(0.0, near_surface, (half, 3))
    lower, upper = truth.samples.min(axis=0) - beyond_box, truth.samples.max(axis=0) + beyond_box
    return np.concatenate([near, rng.uniform(lower, upper, (half, 3))])


@lru_cache(maxsize=8)
def _truth(family: str, seed: int) -> TrueGrasps:
    try:
        return TrueGrasps(make_shape(family, seed).mesh)
    except MeshError as error:
        raise MeshError(
            f"{error}: grasp diffusion learns on our own shapes; make them with `feasigrasp train "
            "sampler-data`"
        ) from error


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_data_argument(parser)
    add_run_arguments(parser, out="out/train_diffusion")
    add_loop_arguments(parser, batch=8, rate=2e-3, of="clouds")
    parser.add_argument(
        "--poses", type=positive, default=32, help="Number of hand poses of each cloud."
    )
    add_evaluation_arguments(parser, minutes_=60, every=200, patience=1000, held_out=96)
    parser.add_argument("--quick", action="store_true", help="Train on a sample, for 1 minute.")


class Training(TrainingRun[PoseEnergy]):
    """One training run; the running means of the weights are what is judged and written."""

    weights = "grasp_diffusion.npz"
    columns = (
        *("step", "minutes", "learning_rate"),
        *("train_loss", "train_score", "train_distance"),
        *("held_out_score", "held_out_score_fine", "held_out_distance_mm"),
    )
    criterion, less_is_better = "held_out_score", True
    shown = (
        "score {held_out_score:.3f}, of little noise {held_out_score_fine:.3f}, "
        "distance {held_out_distance_mm:.1f} mm"
    )

    def __init__(
        self, args: argparse.Namespace, examples: PoseExamples, held_out: PoseExamples
    ) -> None:
        self.examples, self.held_out = examples, held_out
        identity = {
            **{"seed": args.seed, "batch": args.batch, "poses": args.poses},
            **{"examples": len(examples["family"]), "held_out": len(held_out["family"])},
        }
        optimizer = torch.optim.AdamW, {"lr": args.learning_rate, "weight_decay": 1e-4}
        network = GraspDiffusion.untrained(args.seed).network
        super().__init__(args, network, optimizer, identity)

    def losses(self) -> dict[str, Tensor]:
        """The loss of a batch, and its parts."""
        n, args = len(self.examples["family"]), self.args
        chosen = rows_of_step(n, args.batch, args.seed, self.step)
        batch = self._drawn(self.examples, chosen, self.step)
        score, distance = errors(self.network, batch)
        parts = {"score": score.mean(), "distance": distance.mean()}
        return {"loss": parts["score"] + parts["distance"], **parts}

    def measure(self) -> dict[str, float]:
        """Both parts of the loss on the same noise every time."""
        # Examples of one evaluation at a time.
        at_once = 8
        scores, fine, distances = [], [], []
        n = len(self.held_out["family"])
        for start in range(0, n, at_once):
            rows = np.arange(start, min(start + at_once, n))
            batch = self._drawn(self.held_out, rows, -1 - start)
            score, distance = (part.detach() for part in errors(self.averaged, batch))
            scores.append(score.mean(-1).flatten())
            fine.append(score[batch.time < 0.1].flatten())
            distances.append(distance.flatten())
        means = [float(torch.cat(part).mean()) for part in (scores, fine, distances)]
        return {
            "held_out_score": means[0],
            "held_out_score_fine": means[1],
            "held_out_distance_mm": 1e3 * LENGTH * means[2],
        }

    def export(self) -> None:
        """Writes the running means."""
        GraspDiffusion(self.averaged).save(self.folder / self.weights)

    def _drawn(self, examples: PoseExamples, rows: np.ndarray, number: int) -> Batch:
        rng = np.random.default_rng([self.args.seed, number & 0xFFFFFFFF, 1])
        batch = drawn_batch(examples, rows, rng, self.args.poses)
        return Batch(*(part.to(self.args.device) for part in batch))


def errors(network: PoseEnergy, batch: Batch) -> tuple[Tensor, Tensor]:
    """Absolute errors of the energy's gradient, per deviation of the noise, and of the distance.

    The authors weigh all noise levels by their gradients, a tenth of noise over variance; here they
    count alike, so that the few steps there are do not all go to the least.

    Returns:
        Shapes (B, P, 6) and (B, S), the latter in units.
    """
    # Signed distances beyond this are all the same, in units; the authors clip there.
    farthest = 0.6
    cloud = network.encode(batch.points, batch.normals)
    found = network.gradient(cloud, batch.R, batch.p, batch.time, train=True)
    deviation = standard_deviation(batch.time).unsqueeze(-1)
    score = (deviation * (found - batch.gradient)).abs()
    distance = network.features(cloud, batch.places, batch.axes, batch.times)[..., 0]
    clipped = (part.clamp(-farthest, farthest) for part in (distance, batch.distance))
    return score, torch.sub(*clipped).abs()


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training."""
    shards = data_files(args.data, "shape_*.npz", "shards of our own shapes")
    if args.quick:
        shards, args.default_minutes = shards[:8], 1.0
    files = [args.out / "poses" / shard.name for shard in shards]
    make = partial(write_hand_poses, shards=shards)
    made = make_shards(files, make, jobs=args.jobs, desc="hand poses")
    return Training(args, *load_pose_examples(made, args.seed, args.held_out)).run()
