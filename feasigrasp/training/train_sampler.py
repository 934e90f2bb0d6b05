"""``feasigrasp train sampler``: trains a grasp network.

It learns from the shards that `feasigrasp.training.sampler_data` makes, whole clouds of points.
Families of shapes that are held out are never trained on: they judge. The batch of a step depends
on the seed and the step alone, so that a run that was interrupted goes on as if it had not been;
start the same command again to resume. What is judged, exported and shipped are the running means
of the weights.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from feasigrasp.models.grasps.network.network import GraspNetwork, Preset
from feasigrasp.results.arguments import positive
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.rows import write_json
from feasigrasp.training.data.household_shapes import HELD_OUT
from feasigrasp.training.files import (
    TrainingError,
    append_curve,
    read_checkpoint,
    without_denormals,
    write_checkpoint,
)
from feasigrasp.training.grasp_batches import Examples, load_examples
from feasigrasp.training.grasp_losses import loss
from feasigrasp.training.grasp_validation import METRICS, held_out_metrics

#: Steps over which the learning rate rises to its full value.
WARM_UP = 100
#: Largest norm of the gradient.
LARGEST_GRADIENT = 2.0
#: Weight decay of the optimiser.
DECAY = 1e-3
#: What decides which weights are kept, of `METRICS`: how well contacts are ranked. How sure
#: probabilities are, which the loss counts as well, `fit certainty` mends.
CRITERION = "contact_ap_completed"
#: Steps over which the weights are averaged, at most.
AVERAGED = 300
#: What ``--quick`` trains on, and for how long [min].
QUICK_EXAMPLES, QUICK_MINUTES = 60, 1.0
#: Entry of the random seed that keeps the choice of points apart from that of examples.
_POINTS = 1
COLUMNS = (
    "step",
    "minutes",
    "learning_rate",
    *(f"train_{part}" for part in ("loss", "contact", "width", "closing", "approach")),
    *(f"held_out_{metric}" for metric in METRICS),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("--preset", choices=list(Preset), default="default")
    parser.add_argument(
        "--data", type=Path, default=Path("out/sampler_data"), help="folder of the shards"
    )
    parser.add_argument(
        "--out", type=Path, help="folder of the run (default: out/train_sampler/PRESET)"
    )
    parser.add_argument("--start", type=Path, help="weights to start from instead of random ones")
    parser.add_argument("--seed", type=int, default=0)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=_minutes, help="length of the training (default: 40)")
    length.add_argument("--steps", type=positive, help="its length in steps instead")
    parser.add_argument("--batch", type=positive, default=16, help="clouds of a step")
    parser.add_argument("--points", type=positive, default=128, help="points of each that count")
    parser.add_argument("--learning-rate", type=float, default=3e-3)
    parser.add_argument("--every", type=positive, default=200, help="steps between evaluations")
    parser.add_argument(
        "--patience",
        type=positive,
        default=30,
        help="evaluations without better held-out metrics after which it stops",
    )
    parser.add_argument("--held-out", type=positive, default=120, help="clouds of an evaluation")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--quick", action="store_true", help="on a sample, for a minute")


def _minutes(text: str) -> float:
    minutes = float(text)
    if not minutes > 0.0:
        raise argparse.ArgumentTypeError(f"{text} minutes are no time")
    return minutes


def learning_rate(peak: float, step: int, fraction: float) -> float:
    """Linear rise, then half a cosine down to a hundredth at ``fraction`` = 1 of the run."""
    fall = 0.5 * (1.0 + math.cos(math.pi * min(fraction, 1.0)))
    return peak * min(1.0, (step + 1) / WARM_UP) * (1e-2 + (1.0 - 1e-2) * fall)


class Training:
    """One training run with its files in a folder.

    ``checkpoint.pt`` is what it resumes from, ``curve.csv`` one line for every evaluation,
    ``grasp_network.npz`` the weights with the best held-out `CRITERION`.

    Args:
        args: Arguments of the command, ``out`` filled in.
        examples: What to train on.
        held_out: What to judge with.

    Raises:
        TrainingError: The folder holds a run with another seed, batch, preset or data, or there is
            no such device.
    """

    def __init__(self, args: argparse.Namespace, examples: Examples, held_out: Examples) -> None:
        self.args, self.folder, self.preset = args, args.out, args.preset
        self.examples, self.held_out = examples, held_out
        self.minutes = 40.0 if args.minutes is None and args.steps is None else args.minutes
        self.network = self._untrained()
        try:
            self.network.to(args.device)
        except RuntimeError as error:
            raise TrainingError(f"cannot train on --device {args.device}: {error}") from None
        self.network.train().requires_grad_(True)
        self.averaged = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=args.learning_rate, weight_decay=DECAY
        )
        self.step, self.seconds = 0, 0.0
        self.best, self.worse = -math.inf, 0
        self.identity = {
            "preset": args.preset,
            "seed": args.seed,
            "batch": args.batch,
            "examples": len(examples),
            "held_out": len(held_out),
        }
        self._resume()

    def _untrained(self) -> nn.Module:
        if self.args.start is None:
            return GraspNetwork.untrained(self.preset, self.args.seed).network
        start = GraspNetwork.load(self.args.start)
        if start.preset != self.preset:
            raise TrainingError(
                f"--start {self.args.start} holds preset {start.preset}, not {self.preset}"
            )
        return start.network

    @property
    def fraction(self) -> float:
        """How much of the run is done, in [0, 1]."""
        if self.minutes is None:
            return self.step / float(self.args.steps)
        return self.seconds / (60.0 * self.minutes)

    @property
    def finished(self) -> bool:
        """Whether its time or its steps are used up, or it got no better for too long."""
        return self.fraction >= 1.0 or self.worse >= self.args.patience

    def advance(self) -> dict[str, float]:
        """One step of the optimiser; the loss of its batch and its parts."""
        started = time.perf_counter()
        rate = learning_rate(self.args.learning_rate, self.step, self.fraction)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        rng = np.random.default_rng([self.args.seed, self.step, _POINTS])
        contacts, labels = self.examples.batch(self._rows(), self.args.device)
        size, n = labels.contact.shape
        points = rng.random((size, n)).argsort(1)[:, : self.args.points]
        rows = torch.from_numpy(points).to(self.args.device)
        total, parts = loss(self.preset, self.network(contacts, rows), labels.chosen(rows))
        self.optimizer.zero_grad()
        total.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
        self.optimizer.step()
        self.step += 1
        share = max(1.0 / AVERAGED, 1.0 / self.step)
        with torch.no_grad():
            for mean, now in zip(
                self.averaged.parameters(), self.network.parameters(), strict=True
            ):
                mean.lerp_(now, share)
        self.seconds += time.perf_counter() - started
        return {"loss": float(total.detach()), **{k: float(v.detach()) for k, v in parts.items()}}

    def _rows(self) -> np.ndarray:
        """The examples of this step: every epoch passes over all of them in another order."""
        n, batch = len(self.examples), min(self.args.batch, len(self.examples))
        epoch, place = divmod(self.step, n // batch)
        order = np.random.default_rng([self.args.seed, epoch]).permutation(n)
        return order[place * batch : (place + 1) * batch]

    def evaluate(self, train: dict[str, float]) -> dict[str, float]:
        """Held-out metrics; writes the curve, the best weights and the checkpoint."""
        metrics = held_out_metrics(self.preset, self.averaged, self.held_out)
        row = {
            "step": float(self.step),
            "minutes": self.seconds / 60.0,
            "learning_rate": self.optimizer.param_groups[0]["lr"],
            **{f"train_{name}": value for name, value in train.items()},
            **{f"held_out_{name}": value for name, value in metrics.items()},
        }
        ranked = float(np.nan_to_num(metrics[CRITERION]))  # NaN without a contact
        if ranked > self.best:
            self.best, self.worse = ranked, 0
            template = GraspNetwork.untrained(self.preset)
            GraspNetwork(self.preset, self.averaged, template.gripper).save(
                self.folder / "grasp_network.npz"
            )
        else:
            self.worse += 1
        append_curve(self.folder, COLUMNS, row)
        self.save()
        return metrics

    def save(self) -> None:
        """Writes the checkpoint."""
        write_checkpoint(
            self.folder,
            self.identity,
            network=self.network.state_dict(),
            averaged=self.averaged.state_dict(),
            optimizer=self.optimizer.state_dict(),
            progress=[self.step, self.seconds, self.best, self.worse],
        )

    def _resume(self) -> None:
        state = read_checkpoint(self.folder, self.identity, self.args.device)
        if state is None:
            return
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds, self.best, self.worse = state["progress"]


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training, and prints the last held-out metrics."""
    if args.out is None:
        args.out = Path("out/train_sampler") / args.preset
    most = None
    if args.quick:
        most, args.held_out = QUICK_EXAMPLES, min(args.held_out, QUICK_EXAMPLES // 2)
        if args.steps is None and args.minutes is None:
            args.minutes = QUICK_MINUTES
    examples, held_out = load_examples(args.data, HELD_OUT, args.seed, args.held_out, most)
    training = Training(args, examples, held_out)
    write_json(
        {"git": git_revision(), "versions": versions(), **training.identity},
        args.out / "run.json",
    )
    if training.finished:
        print(f"{args.out} is finished; give more --minutes or --steps to go on with it")
        return 0
    try:
        _train(training)
    except KeyboardInterrupt:
        training.save()
        print(f"interrupted at step {training.step}; the same command goes on from there")
        return 130
    print(f"step {training.step}: best held-out {CRITERION} {training.best:.3f}; weights, curve in")
    print(f"{args.out}/grasp_network.npz and {args.out}/curve.csv")
    return 0


def _train(training: Training) -> None:
    history: list[dict[str, float]] = []
    format_bar = "{l_bar}{bar}| {elapsed}{postfix}"
    with tqdm(total=1.0, initial=training.fraction, bar_format=format_bar) as bar:
        while not training.finished:
            history.append(training.advance())
            bar.n = min(training.fraction, 1.0)
            bar.update(0)
            if training.step % training.args.every == 0 or training.fraction >= 1.0:
                means = {k: float(np.nanmean([h[k] for h in history])) for k in history[0]}
                history.clear()
                metrics = training.evaluate(means)
                bar.set_postfix_str(
                    f"step {training.step}, AP {metrics['contact_ap_completed']:.3f}, "
                    f"width {metrics['width_mm']:.1f} mm, b {metrics['closing_deg']:.1f} deg, "
                    f"a {metrics['approach_valid_percent']:.0f} %"
                )
