"""``feasigrasp train hidden-side``: trains what perception expects behind what it sees.

First it makes pictures of household shapes (`feasigrasp.training.data.hidden_side`), in shards
that are kept; then it trains `feasigrasp.models.shape.hidden_side_network` on them. Whole
families are held out and judge. The batch of a step depends on the seed and the step alone: a run
that was interrupted goes on as if it had not been; start the same command again to resume. The
running means of the weights are what is judged and written.
"""

from __future__ import annotations

import argparse
import copy
import math
import time
from pathlib import Path

import joblib
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from feasigrasp.models.shape.hidden_side import TYPICAL_SIZE
from feasigrasp.models.shape.hidden_side_network import BELIEVED, HiddenSide, HiddenSideNetwork
from feasigrasp.results.arguments import positive
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.rows import write_json
from feasigrasp.training.data.hidden_side import object_pictures
from feasigrasp.training.data.household_shapes import HELD_OUT
from feasigrasp.training.data.object_streams import ObjectStream
from feasigrasp.training.files import (
    append_curve,
    read_checkpoint,
    without_denormals,
    write_checkpoint,
)

Pictures = tuple[NDArray[np.float16], NDArray[np.float16]]

#: Objects of a shard.
SHARD = 64
#: Steps over which the learning rate rises, and the weights are averaged.
WARM_UP, AVERAGED = 100, 300
#: Steps between two lines of the curve.
EVERY = 200
LARGEST_GRADIENT = 2.0
#: What ``--quick`` makes and does.
QUICK_OBJECTS, QUICK_STEPS = 64, 40
COLUMNS = (
    "step",
    "minutes",
    "train_loss",
    "held_out_loss",
    "held_out_mm",
    "held_out_ratio",
    "believed_mm",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("--out", type=Path, default=Path("out/train_hidden_side"))
    parser.add_argument("--objects", type=positive, default=2048, help="household shapes")
    parser.add_argument("--views", type=positive, default=12, help="pictures of each")
    parser.add_argument("--steps", type=positive, default=8000)
    parser.add_argument("--batch", type=positive, default=32)
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--jobs", type=positive, default=joblib.cpu_count(), help="processes that make pictures"
    )
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--quick", action="store_true", help="on a sample, for a minute")


def make_pictures(folder: Path, objects: int, views: int, seed: int, jobs: int) -> list[Path]:
    """Makes the shards that are not there yet; one file for those held out beside each."""
    files = [folder / f"pictures_{number:04d}.npz" for number in range(-(-objects // SHARD))]
    missing = [number for number, file in enumerate(files) if not file.exists()]
    made = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(_write_shard)(files[number], number, views, seed) for number in missing
    )
    done = len(files) - len(missing)
    for _ in tqdm(made, total=len(files), initial=done, desc="pictures", unit="shard"):
        pass
    return files


def _write_shard(filename: Path, number: int, views: int, seed: int) -> None:
    stream = ObjectStream("shape", None, seed)
    seen, truth, held = [], [], []
    for index in range(number * SHARD, (number + 1) * SHARD):
        pictures, thickness = object_pictures(stream, index, views)
        seen.append(pictures.astype(np.float16))
        truth.append(thickness.astype(np.float16))
        held.append(np.full(len(pictures), stream[index].family in HELD_OUT))
    filename.parent.mkdir(parents=True, exist_ok=True)
    partial = filename.with_suffix(".part")
    with partial.open("wb") as file:
        np.savez_compressed(
            file,
            pictures=np.concatenate(seen),
            thickness=np.concatenate(truth),
            held_out=np.concatenate(held),
        )
    partial.replace(filename)


def read_pictures(files: list[Path]) -> tuple[Pictures, Pictures]:
    """Pictures and thickness to train on, and those that judge."""
    shards = []
    for file in files:
        with np.load(file) as shard:
            shards.append((shard["pictures"], shard["thickness"], shard["held_out"]))
    pictures, thickness, held = (np.concatenate(part) for part in zip(*shards, strict=True))
    return (pictures[~held], thickness[~held]), (pictures[held], thickness[held])


def loss(median: Tensor, spread: Tensor, truth: Tensor) -> Tensor:
    """Negative log likelihood of a Laplace distribution, pixels without truth left out."""
    known = torch.isfinite(truth)
    error = (torch.nan_to_num(truth) - median).abs()
    return (error / spread + torch.log(2.0 * spread))[known].mean()


class Training:
    """One training run with its files in a folder: ``checkpoint.pt``, ``curve.csv``, the weights.

    Args:
        args: Arguments of the command.
        train: What to train on.
        judge: What to judge with.

    Raises:
        TrainingError: The folder holds a run with other settings.
    """

    def __init__(self, args: argparse.Namespace, train: Pictures, judge: Pictures) -> None:
        self.args, self.folder, self.pictures, self.judge = args, args.out, train, judge
        torch.manual_seed(args.seed)
        self.network = HiddenSideNetwork().to(args.device)
        self.averaged = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), weight_decay=1e-3)
        self.step, self.seconds = 0, 0.0
        self.identity = {
            "seed": args.seed,
            "batch": args.batch,
            "steps": args.steps,
            "pictures": len(train[0]),
            "held_out": len(judge[0]),
        }
        state = read_checkpoint(self.folder, self.identity, args.device)
        if state is not None:
            self.network.load_state_dict(state["network"])
            self.averaged.load_state_dict(state["averaged"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.seconds = state["progress"]

    def advance(self) -> float:
        """One step of the optimiser; the loss of its batch."""
        started = time.perf_counter()
        fall = 0.5 * (1.0 + math.cos(math.pi * self.step / self.args.steps))
        rate = self.args.learning_rate * min(1.0, (self.step + 1) / WARM_UP) * (0.01 + 0.99 * fall)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        seen, truth = self._batch()
        median, spread = self.network(seen)
        value = loss(median, spread, truth)
        self.optimizer.zero_grad()
        value.backward()  # type: ignore[no-untyped-call]
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
        return float(value.detach())

    def _batch(self) -> tuple[Tensor, Tensor]:
        """The pictures of this step, turned by quarter turns and mirrored at random."""
        n, batch = len(self.pictures[0]), min(self.args.batch, len(self.pictures[0]))
        epoch, place = divmod(self.step, n // batch)
        order = np.random.default_rng([self.args.seed, epoch]).permutation(n)
        rows = np.sort(order[place * batch : (place + 1) * batch])
        turn, mirror = np.random.default_rng([self.args.seed, self.step, 1]).integers((4, 2))
        seen, truth = (_tensor(part[rows], self.args.device) for part in self.pictures)
        seen, truth = (torch.rot90(part, int(turn), (-2, -1)) for part in (seen, truth))
        return (seen.flip(-1), truth.flip(-1)) if mirror else (seen, truth)

    def evaluate(self, train_loss: float) -> dict[str, float]:
        """Figures on what is held out; writes curve, checkpoint and weights."""
        losses, errors, ratios, believed = [], [], [], []
        for start in range(0, len(self.judge[0]), 64):
            rows = slice(start, start + 64)
            seen, truth = (_tensor(part[rows], self.args.device) for part in self.judge)
            with torch.inference_mode():
                median, spread = self.averaged(seen)
                losses.append(float(loss(median, spread, truth)))
            scale = TYPICAL_SIZE * torch.exp(seen[:, 3].amin(dim=(1, 2)) + seen[:, 3].amax((1, 2)))
            error = (truth - median).abs()
            errors.append(float((1e3 * scale[:, None, None] * error).nanmean()))
            ratios.append(float((error / spread).nanmean()))
            before = (truth - seen[:, BELIEVED]).abs()
            believed.append(float((1e3 * scale[:, None, None] * before).nanmean()))
        metrics = {
            "held_out_loss": float(np.mean(losses)),
            "held_out_mm": float(np.mean(errors)),
            "held_out_ratio": float(np.mean(ratios)),
            "believed_mm": float(np.mean(believed)),
        }
        about = {"step": self.step, "minutes": self.seconds / 60.0, "train_loss": train_loss}
        append_curve(self.folder, COLUMNS, about | metrics)
        HiddenSide(copy.deepcopy(self.averaged).cpu()).save(self.folder / "hidden_side.npz")
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
            progress=[self.step, self.seconds],
        )


def _tensor(part: NDArray[np.float16], device: str) -> Tensor:
    return torch.from_numpy(part.astype(np.float32)).to(device)


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Makes the pictures, trains or goes on with training, and prints the last figures."""
    if args.quick:
        args.objects, args.steps = min(args.objects, QUICK_OBJECTS), min(args.steps, QUICK_STEPS)
    files = make_pictures(args.out / "pictures", args.objects, args.views, args.seed, args.jobs)
    training = Training(args, *read_pictures(files))
    write_json(
        {"git": git_revision(), "versions": versions(), **training.identity},
        args.out / "run.json",
    )
    history: list[float] = []
    try:
        with tqdm(total=args.steps, initial=training.step, unit="step") as bar:
            while training.step < args.steps:
                history.append(training.advance())
                bar.update()
                if training.step % EVERY == 0 or training.step == args.steps:
                    metrics = training.evaluate(float(np.mean(history)))
                    history.clear()
                    bar.set_postfix_str(f"held out {metrics['held_out_mm']:.2f} mm")
    except KeyboardInterrupt:
        training.save()
        print(f"interrupted at step {training.step}; the same command goes on from there")
        return 130
    print(f"weights and curve are in {args.out}/hidden_side.npz and {args.out}/curve.csv")
    return 0
