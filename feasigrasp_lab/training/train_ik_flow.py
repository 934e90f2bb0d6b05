"""``feasigrasp train ik-flow``: train the IK flow by maximum likelihood.

Every batch is drawn anew: configurations uniform inside the limits and free of self-collision, and
their flange poses. Start the same command again to resume.
"""

from __future__ import annotations

import argparse
import math

import numpy as np
import torch
from torch import Tensor, nn

from feasigrasp.models.arrays import Array
from feasigrasp.models.ik.flow import DAMPING, IkFlow
from feasigrasp.models.ik.flow_layers import FlowShape
from feasigrasp.models.ik.least_squares import refine
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.robot.self_collision import in_collision
from feasigrasp.runs.results.arguments import add_run_arguments
from feasigrasp_lab.training.ik_flow_network import IkFlowNetwork
from feasigrasp_lab.training.loop import TrainingRun, add_evaluation_arguments, add_loop_arguments

#: Entry of the random seed that keeps the held-out poses apart from all batches.
_HELD_OUT = 2**32 - 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/ik_flow", jobs=False)
    add_loop_arguments(parser, batch=1024, rate=2e-3, of="samples")
    add_evaluation_arguments(parser, minutes_=60, every=500, patience=20, held_out=4000)


def training_batch(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Configurations (<= n, 7) [rad], uniform where free of self-collision, and flange poses."""
    q = IIWA_7.random_positions(rng, n)
    q = q[~in_collision(q)]
    return q, forward_kinematics(q)


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


class Training(TrainingRun[IkFlowNetwork]):
    """One training run; the weights with the best held-out likelihood are kept.

    Args:
        args: Arguments of the command.
        shape: Sizes of the networks.
    """

    weights = "ik_flow.npz"
    columns = (
        *("step", "minutes", "learning_rate", "train_nll", "held_out_nll"),
        *(f"held_out_nll_q{joint + 1}" for joint in range(7)),
        *("position_mm_median", "position_mm_mean", "angle_deg_median", "angle_deg_mean"),
        "refined_percent",
    )
    shown = (
        "held-out NLL {held_out_nll:.2f}, {position_mm_median:.1f} mm, "
        "refined {refined_percent:.1f} %"
    )
    criterion, less_is_better = "held_out_nll", True
    warm_up, least, averaged_over = 200, 1e-3, 0
    #: Of one joint's network.
    largest_gradient = 5.0

    def __init__(self, args: argparse.Namespace, shape: FlowShape) -> None:
        identity = {"seed": args.seed, "batch": args.batch, "shape": shape.as_dict()}
        torch.manual_seed(args.seed)
        optimizer = torch.optim.Adam, {"lr": args.learning_rate}
        super().__init__(args, IkFlowNetwork(shape), optimizer, identity)
        self.held_out = training_batch(np.random.default_rng([args.seed, _HELD_OUT]), args.held_out)

    def losses(self) -> dict[str, Tensor]:
        """The negative log likelihood of new samples."""
        rng = np.random.default_rng([self.args.seed, self.step])
        q, X_WF = (_tensor(part, self.args.device) for part in training_batch(rng, self.args.batch))
        return {"nll": -self.network(q, X_WF)[1].mean(0).sum()}

    def clipped(self) -> list[nn.Module]:
        """The network of each joint."""
        return list(self.network.factors)

    def measure(self) -> dict[str, float]:
        """See `held_out_metrics`."""
        return held_out_metrics(self.network, *self.held_out)

    def export(self) -> None:
        """Writes the flow."""
        export(self.network).save(self.folder / self.weights)


def _tensor(array: Array, device: torch.device | str) -> Tensor:
    return torch.as_tensor(array, dtype=torch.float32, device=device)


def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training."""
    return Training(args, FlowShape()).run()
