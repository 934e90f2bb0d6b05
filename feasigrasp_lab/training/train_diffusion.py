"""``feasigrasp train diffusion``: train the grasp-diffusion baseline on the sampler's data.

From the shards of ``feasigrasp train sampler-data`` it makes valid hand poses and signed distances,
in shards that are kept, and trains `feasigrasp_lab.baselines.diffusion_energy` on them by denoising
score matching on SE(3). Families of shapes that are held out judge; start the same command again to
resume.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from feasigrasp.runs.results.arguments import add_run_arguments, positive
from feasigrasp_lab.baselines.diffusion_energy import LENGTH, PoseEnergy, standard_deviation
from feasigrasp_lab.baselines.grasp_diffusion import GraspDiffusion
from feasigrasp_lab.results.finished import make_shards
from feasigrasp_lab.training.data.hand_poses import write_hand_poses
from feasigrasp_lab.training.data.household_shapes import HELD_OUT
from feasigrasp_lab.training.diffusion_batches import Batch, PoseExamples, load_pose_examples
from feasigrasp_lab.training.loop import (
    TrainingError,
    TrainingRun,
    add_evaluation_arguments,
    add_loop_arguments,
    rows_of_step,
    without_denormals,
)

#: What ``--quick`` trains on, and for how long [min].
QUICK_SHARDS, QUICK_MINUTES = 8, 1.0
#: Points of a cloud and places beside it that a step looks at.
POINTS, PLACES = 256, 64
#: Signed distances beyond this are all the same, in units; the authors clip there.
_FARTHEST = 0.6
#: Examples of one evaluation at a time.
_AT_ONCE = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    data = Path("out/sampler_data")
    parser.add_argument("--data", type=Path, default=data, help="Folder of the training data.")
    add_run_arguments(parser, out="out/train_diffusion")
    add_loop_arguments(parser, batch=8, rate=2e-3, of="clouds")
    parser.add_argument(
        "--poses", type=positive, default=32, help="Number of hand poses of each cloud."
    )
    add_evaluation_arguments(parser, minutes_=60, every=200, patience=1000, held_out=96)
    parser.add_argument("--quick", action="store_true", help="Train on a sample, for 1 minute.")


class Training(TrainingRun[PoseEnergy]):
    """One training run; the running means of the weights are what is judged and written.

    Args:
        args: Arguments of the command.
        examples: What to train on.
        held_out: What to judge with.
    """

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
            **{"examples": len(examples), "held_out": len(held_out)},
        }
        optimizer = torch.optim.AdamW, {"lr": args.learning_rate, "weight_decay": 1e-4}
        network = GraspDiffusion.untrained(args.seed).network
        super().__init__(args, network, optimizer, identity)

    def losses(self) -> dict[str, Tensor]:
        """The loss of a batch, and its parts."""
        chosen = rows_of_step(len(self.examples), self.args.batch, self.args.seed, self.step)
        batch = self._drawn(self.examples, chosen, self.step)
        score, distance = errors(self.network, batch)
        parts = {"score": score.mean(), "distance": distance.mean()}
        return {"loss": parts["score"] + parts["distance"], **parts}

    def measure(self) -> dict[str, float]:
        """Both parts of the loss on the same noise every time."""
        scores, fine, distances = [], [], []
        for start in range(0, len(self.held_out), _AT_ONCE):
            rows = np.arange(start, min(start + _AT_ONCE, len(self.held_out)))
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
        sizes = {"points": POINTS, "poses": self.args.poses, "places": PLACES}
        batch = examples.batch(rows, rng, **sizes)
        return Batch(*(part.to(self.args.device) for part in batch))


def errors(network: PoseEnergy, batch: Batch) -> tuple[Tensor, Tensor]:
    """Absolute errors of the energy's gradient, per deviation of the noise, and of the distance.

    The authors weigh all noise levels by their gradients, a tenth of noise over variance; here they
    count alike, so that the few steps there are do not all go to the least.

    Returns:
        Shapes (B, P, 6) and (B, S), the latter in units.
    """
    cloud = network.encode(batch.points, batch.normals)
    found = network.gradient(cloud, batch.R, batch.p, batch.time, train=True)
    deviation = standard_deviation(batch.time).unsqueeze(-1)
    score = (deviation * (found - batch.gradient)).abs()
    said = network.features(cloud, batch.places, batch.axes, batch.times)[..., 0]
    clipped = (part.clamp(-_FARTHEST, _FARTHEST) for part in (said, batch.distance))
    return score, torch.sub(*clipped).abs()


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training."""
    shards = sorted(args.data.glob("shape_*.npz"))
    if not shards:
        raise TrainingError(
            f"there are no shards of our own shapes in {args.data}; make them with `feasigrasp "
            "train sampler-data`, or name their folder with --data"
        )
    if args.quick:
        shards = shards[:QUICK_SHARDS]
        if args.steps is None and args.minutes is None:
            args.minutes = QUICK_MINUTES
    files = [args.out / "poses" / shard.name for shard in shards]
    make = partial(write_hand_poses, shards=shards)
    make_shards(files, make, jobs=args.jobs, desc="hand poses")
    made = [file for file in files if file.exists()]
    examples, held_out = load_pose_examples(made, HELD_OUT, args.seed, args.held_out)
    return Training(args, examples, held_out).run()
