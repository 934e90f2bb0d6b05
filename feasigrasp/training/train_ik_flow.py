"""``feasigrasp train ik-flow``: trains the IK flow by maximum likelihood on forward kinematics.

Every batch is drawn anew: configurations uniform inside the limits and free of self-collision, and
their flange poses. The batch of a step depends on the seed and the step alone, so that a run that
was interrupted goes on as if it had not been; start the same command again to resume.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.ik.flow import DAMPING, IkFlow
from feasigrasp.models.ik.flow_layers import FlowShape
from feasigrasp.models.ik.least_squares import refine
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.robot.self_collision import in_collision
from feasigrasp.results.arguments import positive
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.rows import write_json
from feasigrasp.training.files import (
    TrainingError,
    append_curve,
    read_checkpoint,
    write_checkpoint,
)
from feasigrasp.training.ik_flow_network import IkFlowNetwork

#: Steps over which the learning rate rises to its full value.
WARM_UP = 200
#: Largest gradient norm of one joint's network.
LARGEST_GRADIENT = 5.0
#: Entry of the random seed that keeps the held-out poses apart from all batches.
_HELD_OUT = 2**32 - 1
COLUMNS = (
    "step",
    "minutes",
    "learning_rate",
    "train_nll",
    "held_out_nll",
    *(f"held_out_nll_q{joint + 1}" for joint in range(IIWA_7.joints)),
    "position_mm_median",
    "position_mm_mean",
    "angle_deg_median",
    "angle_deg_mean",
    "refined_percent",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("--out", type=Path, default=Path("out/ik_flow"), help="folder of the run")
    parser.add_argument("--seed", type=int, default=0)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=_minutes, help="length of the training (default: 60)")
    length.add_argument("--steps", type=positive, help="its length in steps instead")
    parser.add_argument("--batch", type=positive, default=1024, help="samples of a step")
    parser.add_argument("--learning-rate", type=float, default=2e-3)
    parser.add_argument("--every", type=positive, default=500, help="steps between evaluations")
    parser.add_argument(
        "--patience",
        type=positive,
        default=20,
        help="evaluations without a better held-out likelihood after which it stops",
    )
    parser.add_argument("--held-out", type=positive, default=4000, help="poses of an evaluation")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")


def _minutes(text: str) -> float:
    minutes = float(text)
    if not minutes > 0.0:
        raise argparse.ArgumentTypeError(f"{text} minutes are no time")
    return minutes


def training_batch(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Configurations (<= n, 7) [rad], uniform where free of self-collision, and flange poses."""
    q = IIWA_7.random_positions(rng, n)
    q = q[~in_collision(q)]
    return q, forward_kinematics(q)


def learning_rate(peak: float, step: int, fraction: float) -> float:
    """Linear rise, then half a cosine down to a thousandth at ``fraction`` = 1 of the run."""
    fall = 0.5 * (1.0 + math.cos(math.pi * min(fraction, 1.0)))
    return peak * min(1.0, (step + 1) / WARM_UP) * (1e-3 + (1.0 - 1e-3) * fall)


def export(network: IkFlowNetwork) -> IkFlow:
    """The flow without torch."""
    state = network.state_dict()
    arrays = {name: tensor.detach().cpu().numpy().copy() for name, tensor in state.items()}
    return IkFlow(network.shape, arrays)


def held_out_metrics(network: IkFlowNetwork, q: Array, X_WF: Array) -> dict[str, float]:
    """Negative log likelihood of configurations, and how well samples reach their poses."""
    device = next(network.parameters()).device
    with torch.no_grad():
        density = -network(_tensor(q, device), _tensor(X_WF, device))[1].double().mean(0)
    flow = export(network)
    sample = flow.sample(X_WF)[:, 0]
    _, position, angle = refine(X_WF, sample, 0, DAMPING)
    _, refined_position, refined_angle = refine(X_WF, sample, 3, DAMPING, limit_margin=0.0)
    reached = (refined_position < 1e-3) & (refined_angle < math.radians(1.0))
    return {
        "held_out_nll": float(density.sum()),
        **{f"held_out_nll_q{joint + 1}": float(density[joint]) for joint in range(IIWA_7.joints)},
        "position_mm_median": 1e3 * float(np.median(position)),
        "position_mm_mean": 1e3 * float(position.mean()),
        "angle_deg_median": math.degrees(float(np.median(angle))),
        "angle_deg_mean": math.degrees(float(angle.mean())),
        "refined_percent": 100.0 * float(reached.mean()),
    }


class Training:
    """One training run with its files in a folder.

    ``checkpoint.pt`` is what it resumes from, ``curve.csv`` one line for every evaluation,
    ``ik_flow.npz`` the weights with the best held-out likelihood.

    Args:
        args: Arguments of the command.
        shape: Sizes of the networks.

    Raises:
        TrainingError: The folder holds a run with another seed, batch or network, or there is no
            such device.
    """

    def __init__(self, args: argparse.Namespace, shape: FlowShape) -> None:
        self.args, self.folder = args, args.out
        self.minutes = 60.0 if args.minutes is None and args.steps is None else args.minutes
        torch.manual_seed(args.seed)
        try:
            self.network = IkFlowNetwork(shape).to(args.device)
        except RuntimeError as error:
            raise TrainingError(f"cannot train on --device {args.device}: {error}") from None
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=args.learning_rate)
        self.step, self.seconds = 0, 0.0
        self.best, self.worse = math.inf, 0
        self.identity = {"seed": args.seed, "batch": args.batch, "shape": shape.as_dict()}
        self.held_out = training_batch(np.random.default_rng([args.seed, _HELD_OUT]), args.held_out)
        self._resume()

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

    def advance(self) -> float:
        """One step of the optimiser; the negative log likelihood of its batch."""
        started = time.perf_counter()
        rate = learning_rate(self.args.learning_rate, self.step, self.fraction)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        rng = np.random.default_rng([self.args.seed, self.step])
        q, X_WF = (_tensor(part, self.args.device) for part in training_batch(rng, self.args.batch))
        loss = -self.network(q, X_WF)[1].mean(0).sum()
        self.optimizer.zero_grad()
        loss.backward()
        for factor in self.network.factors:
            nn.utils.clip_grad_norm_(factor.parameters(), LARGEST_GRADIENT)
        self.optimizer.step()
        self.step += 1
        self.seconds += time.perf_counter() - started
        return float(loss.detach())

    def evaluate(self, train_nll: float) -> dict[str, float]:
        """Held-out metrics; writes the curve, the best weights and the checkpoint."""
        metrics = {
            "step": float(self.step),
            "minutes": self.seconds / 60.0,
            "learning_rate": self.optimizer.param_groups[0]["lr"],
            "train_nll": train_nll,
            **held_out_metrics(self.network, *self.held_out),
        }
        if metrics["held_out_nll"] < self.best:
            self.best, self.worse = metrics["held_out_nll"], 0
            export(self.network).save(self.folder / "ik_flow.npz")
        else:
            self.worse += 1
        append_curve(self.folder, COLUMNS, metrics)
        self.save()
        return metrics

    def save(self) -> None:
        """Writes the checkpoint."""
        write_checkpoint(
            self.folder,
            self.identity,
            network=self.network.state_dict(),
            optimizer=self.optimizer.state_dict(),
            progress=[self.step, self.seconds, self.best, self.worse],
        )

    def _resume(self) -> None:
        state = read_checkpoint(self.folder, self.identity, self.args.device)
        if state is None:
            return
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds, self.best, self.worse = state["progress"]


def _tensor(array: Array, device: torch.device | str) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32, device=device)


def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training, and prints the last held-out metrics."""
    training = Training(args, FlowShape())
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
    print(f"step {training.step}: best held-out NLL {training.best:.3f}; weights and curve in")
    print(f"{args.out}/ik_flow.npz and {args.out}/curve.csv")
    return 0


def _train(training: Training) -> None:
    losses: list[float] = []
    format_bar = "{l_bar}{bar}| {elapsed}{postfix}"
    with tqdm(total=1.0, initial=training.fraction, bar_format=format_bar) as bar:
        while not training.finished:
            losses.append(training.advance())
            bar.n = min(training.fraction, 1.0)
            bar.update(0)
            if training.step % training.args.every == 0 or training.fraction >= 1.0:
                metrics = training.evaluate(float(np.mean(losses)))
                losses.clear()
                bar.set_postfix_str(
                    f"step {training.step}, held-out NLL {metrics['held_out_nll']:.2f}, "
                    f"{metrics['position_mm_median']:.1f} mm, "
                    f"refined {metrics['refined_percent']:.1f} %"
                )
