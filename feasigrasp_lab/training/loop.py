"""Training loop: optimizer, schedule, checkpoints, early stopping, resumption.

The batch of a step depends on the seed and the step alone, so that a run that was interrupted goes
on as if it had not been: the same command resumes it. ``checkpoint.pt`` is what a run resumes from,
``curve.csv`` has one line for every evaluation, ``run.json`` says what made it.
"""

import argparse
import csv
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from feasigrasp.errors import FeasigraspError
from feasigrasp.models.arrays import Indices
from feasigrasp.outputs import replacing, write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import minutes
from feasigrasp_lab.results.workers import made_with
from feasigrasp_lab.training.data.household_shapes import HELD_OUT

Network = TypeVar("Network", bound=nn.Module)

_CHECKPOINT, _CURVE = "checkpoint.pt", "curve.csv"
#: What a checkpoint holds the state of.
_PARTS = ("network", "averaged", "optimizer")


class TrainingError(FeasigraspError, ValueError):
    """A training that cannot start or go on with these arguments or data."""


@contextmanager
def without_denormals() -> Iterator[None]:
    """Numbers too small for full precision count as zero: with them a step takes far longer."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def add_data_argument(parser: argparse.ArgumentParser) -> None:
    """Adds ``--data``."""
    data = Path("out/sampler_data")
    parser.add_argument("--data", type=Path, default=data, help="Folder of the training data.")


def data_files(folder: Path, pattern: str = "*.npz", what: str = "shards") -> list[Path]:
    """The files of such names that ``train sampler-data`` has left in a folder.

    Raises:
        TrainingError: There are none.
    """
    files = sorted(folder.glob(pattern))
    if not files:
        raise TrainingError(
            f"there are no {what} in {folder}; make them with `feasigrasp train sampler-data`, or "
            "name their folder with --data"
        )
    return files


def add_loop_arguments(
    parser: argparse.ArgumentParser, *, batch: int, rate: float, of: str
) -> None:
    """Adds the arguments that every training takes; ``of`` is what a step has a batch of."""
    parser.add_argument("--batch", type=positive, default=batch, help=f"Number of {of} of a step.")
    parser.add_argument("--learning-rate", type=float, default=rate, help="Initial learning rate.")
    device = "cuda" if torch.cuda.is_available() else "cpu"
    parser.add_argument("--device", default=device, help="Device of torch, e.g. cpu or cuda.")


def add_evaluation_arguments(
    parser: argparse.ArgumentParser, *, minutes_: int, every: int, patience: int, held_out: int
) -> None:
    """Adds when a training is judged, and when it ends; the arguments are the defaults."""
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=positive, help="Number of training steps.")
    help_ = f"Duration of the training instead, in minutes. Default: {minutes_}."
    length.add_argument("--minutes", type=minutes, help=help_)
    parser.set_defaults(default_minutes=float(minutes_))
    parser.add_argument("--every", type=positive, default=every, help="Steps between evaluations.")
    help_ = "Number of evaluations without better held-out metrics that ends the training."
    parser.add_argument("--patience", type=positive, default=patience, help=help_)
    help_ = "Number of examples of an evaluation."
    parser.add_argument("--held-out", type=positive, default=held_out, help=help_)


def learning_rate(peak: float, step: int, done: float, warm_up: int, least: float) -> float:
    """Linear rise to a peak, then half a cosine down to a share of it.

    Args:
        peak: The largest rate.
        step: Number of the step, from 0 on.
        done: How much of the run is done; 1 at its end.
        warm_up: Steps of the rise.
        least: Share of the largest rate that is left in the end.
    """
    fall = 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))
    return peak * min(1.0, (step + 1) / warm_up) * (least + (1.0 - least) * fall)


def rows_of_step(n: int, batch: int, seed: int, step: int) -> Indices:
    """The examples, of n, of a step: every epoch passes over all of them in another order."""
    size = min(batch, n)
    epoch, place = divmod(step, n // size)
    order = np.random.default_rng([seed, epoch]).permutation(n)
    return order[place * size : (place + 1) * size]


def split_families(
    family: NDArray[np.str_], what: str, seed: int, n_held_out: int, most: int | None = None
) -> tuple[Indices, Indices]:
    """Draws examples to train on, and some of the families `HELD_OUT` that judge.

    Args:
        family: Of each example.
        what: Whose families these are; begins the message of the error.
        seed: Of the draw.
        n_held_out: Number of examples that judge, at most.
        most: Number of examples to train on, at most; all when None.

    Raises:
        TrainingError: One side would be empty.
    """
    of_held, rng = np.isin(family, HELD_OUT), np.random.default_rng(seed)
    held, rest = np.flatnonzero(of_held), np.flatnonzero(~of_held)
    if len(held) == 0 or len(rest) == 0:
        raise TrainingError(
            f"{what} of the families {', '.join(np.unique(family))}; to train and to judge, both "
            f"these held out are needed and others: {', '.join(HELD_OUT)}"
        )
    held = np.sort(rng.permutation(held)[:n_held_out])
    return np.sort(rng.permutation(rest)[:most]), held


class TrainingRun(ABC, Generic[Network]):
    """One training run with its files in a folder.

    Args:
        args: Arguments of the command; ``out`` is the folder.
        network: What is trained.
        optimizer: Kind of the optimiser, and its options.
        identity: What no resumed run may change, e.g. the seed.

    Raises:
        TrainingError: The folder holds a run with another identity, or there is no such device.
    """

    #: Columns of the curve, the file of the weights that are shipped, and a format of what is shown
    #: of held-out figures.
    columns: tuple[str, ...]
    weights: str
    shown: str
    #: The held-out figure that decides which weights are kept, the last ones when None; and whether
    #: less of it is better.
    criterion: str | None = None
    less_is_better = False
    #: Steps over which the learning rate rises, and the share of it that is left in the end.
    warm_up, least = 100, 1e-2
    #: Largest norm of the gradient.
    largest_gradient = 2.0
    #: Steps over which the weights are averaged, at most.
    averaged_over = 300

    def __init__(
        self,
        args: argparse.Namespace,
        network: Network,
        optimizer: tuple[type[torch.optim.Optimizer], dict[str, Any]],
        identity: dict[str, Any],
    ) -> None:
        self.args, self.folder, self.identity = args, args.out, identity
        try:
            self.network = network.to(args.device)
        except RuntimeError as error:
            raise TrainingError(f"cannot train on --device {args.device}: {error}") from None
        self.network.train().requires_grad_(True)
        self.averaged = deepcopy(self.network).eval().requires_grad_(False)
        #: Parts of the network whose gradients are clipped, each by itself.
        self.clipped: Iterable[nn.Module] = [self.network]
        kind, options = optimizer
        self.optimizer = kind(self.network.parameters(), **options)
        self.minutes: float | None = args.minutes
        if self.minutes is None and args.steps is None:
            self.minutes = args.default_minutes
        self.step, self.seconds, self.worse = 0, 0.0, 0
        self.best = math.inf if self.less_is_better else -math.inf
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / _CHECKPOINT).exists():
            self._resume()
        else:  # if there is a curve, it is that of a run that ended before its first checkpoint
            (self.folder / _CURVE).unlink(missing_ok=True)

    def _resume(self) -> None:
        file = self.folder / _CHECKPOINT
        try:
            state = torch.load(file, map_location=self.args.device, weights_only=True)
        except Exception as error:  # torch raises whatever it stumbles over
            raise TrainingError(
                f"{file} is no whole checkpoint ({str(error).splitlines()[0]}); delete it to begin "
                "anew, or choose another --out"
            ) from error
        if state["identity"] != self.identity:
            raise TrainingError(
                f"{self.folder} holds a run with {state['identity']}, this one has "
                f"{self.identity}; choose another --out, or the same arguments to resume"
            )
        for name in _PARTS:  # once not all trainings had running means
            getattr(self, name).load_state_dict(state.get(name, state["network"]))
        self.step, self.seconds, *judged = state["progress"]
        if judged:
            self.best, self.worse = judged

    @abstractmethod
    def losses(self) -> dict[str, Tensor]:
        """The losses of the batch of this step; the first one is what is minimised."""

    @abstractmethod
    def measure(self) -> dict[str, float]:
        """Held-out figures, by column of the curve."""

    @abstractmethod
    def export(self) -> None:
        """Writes the weights."""

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
        """One step of the optimiser; the losses of its batch."""
        started = time.perf_counter()
        peak = self.args.learning_rate
        rate = learning_rate(peak, self.step, self.fraction, self.warm_up, self.least)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        losses = self.losses()
        self.optimizer.zero_grad()
        next(iter(losses.values())).backward()  # type: ignore[no-untyped-call]
        for part in self.clipped:
            nn.utils.clip_grad_norm_(part.parameters(), self.largest_gradient)
        self.optimizer.step()
        self.step += 1
        share = max(1.0 / self.averaged_over, 1.0 / self.step)
        with torch.no_grad():
            pairs = zip(self.averaged.parameters(), self.network.parameters(), strict=True)
            for mean, now in pairs:
                mean.lerp_(now, share)
        self.seconds += time.perf_counter() - started
        return {name: float(value.detach()) for name, value in losses.items()}

    def evaluate(self, train: Mapping[str, float]) -> dict[str, float]:
        """Held-out figures; writes the curve, the best weights and the checkpoint.

        Args:
            train: Mean losses since the last time, for the curve.
        """
        metrics = self.measure()
        if self._is_best(metrics):
            self.worse = 0
            self.export()
        else:
            self.worse += 1
        row = {
            "step": float(self.step),
            "minutes": self.seconds / 60.0,
            "learning_rate": self.optimizer.param_groups[0]["lr"],
            **{f"train_{name}": value for name, value in train.items()},
            **metrics,
        }
        filename = self.folder / _CURVE
        heads = [] if filename.exists() else [self.columns]
        with filename.open("a", newline="") as file:
            line = [f"{row.get(column, math.nan):.6g}" for column in self.columns]
            csv.writer(file).writerows([*heads, line])
        self.save()
        return metrics

    def save(self) -> None:
        """Writes the checkpoint, whole or not at all."""
        state = {name: getattr(self, name).state_dict() for name in _PARTS}
        progress = [self.step, self.seconds, self.best, self.worse]
        with replacing(self.folder / _CHECKPOINT) as file:
            torch.save({"identity": self.identity, **state, "progress": progress}, file)

    def run(self) -> int:
        """Trains until it is finished, and prints where the results are; the exit status."""
        write_json({**made_with(), **self.identity}, self.folder / "run.json")
        if self.finished:
            print(f"{self.folder} is finished; give a longer training to go on with it")
            return 0
        try:
            self._run()
        except KeyboardInterrupt:
            self.save()
            print(f"interrupted at step {self.step}; the same command goes on from there")
            return 130
        print(f"weights and curve are in {self.folder}/{self.weights} and {self.folder}/curve.csv")
        return 0

    def _run(self) -> None:
        history: list[dict[str, float]] = []
        every: int = self.args.every
        format_bar = "{l_bar}{bar}| {elapsed}{postfix}"
        with tqdm(total=1.0, initial=self.fraction, bar_format=format_bar) as bar:
            while not self.finished:
                history.append(self.advance())
                bar.n = min(self.fraction, 1.0)
                bar.update(0)
                if self.step % every == 0 or self.fraction >= 1.0:
                    means = {k: float(np.nanmean([h[k] for h in history])) for k in history[0]}
                    history.clear()
                    metrics = self.evaluate(means)
                    bar.set_postfix_str(f"step {self.step}, {self.shown.format_map(metrics)}")

    def _is_best(self, metrics: Mapping[str, float]) -> bool:
        """Whether the criterion is better than ever; with none, the last weights are the best."""
        if self.criterion is None:
            return True
        value = float(np.nan_to_num(metrics[self.criterion]))  # NaN with nothing to judge
        better = value < self.best if self.less_is_better else value > self.best
        self.best = value if better else self.best
        return better
