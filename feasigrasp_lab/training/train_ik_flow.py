"""``feasigrasp train ik-flow``: train the IK flow by maximum likelihood.

Every batch is drawn anew: configurations uniform inside the limits and free of self-collision, and
their flange poses. Start the same command again to resume.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import torch
from torch import Tensor, nn

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.arm import in_collision, refine
from feasigrasp_lab.networks import network_arrays
from feasigrasp_lab.paper.ik_flow import DAMPING, IkFlow
from feasigrasp_lab.paper.ik_flow_layers import (
    BACKGROUND,
    FEATURES,
    LENGTH_SCALE,
    PLANES,
    REFERENCES,
    SCALE_BIAS,
    STEPS,
    WIDEST,
    FlowShape,
)
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.training.loop import TrainingRun, add_evaluation_arguments, add_loop_arguments

#: Keeps the gradient of atan2 finite where both arguments vanish. Source: numerical.
_TINY = 1e-12


class JointFactor(nn.Module):
    """The mixture of one joint as a function of what is left to reach: a small perceptron.

    The centres of the components are directions in the plane; a linear path beside the hidden
    layers reaches them, since most of them are linear in the features.

    Args:
        components: Components of the mixture.
        hidden: Width of each hidden layer.
    """

    def __init__(self, components: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.components = components
        sizes = [FEATURES, *hidden]
        self.layers = nn.ModuleList(
            nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )
        self.head = nn.Linear(sizes[-1], 4 * components)
        self.skip = nn.Linear(FEATURES, 2 * components, bias=False)
        with torch.no_grad():  # start with equal weights and centres spread around the circle
            self.head.weight.mul_(0.3)
            self.skip.weight.mul_(0.3)
            angle = torch.arange(components) * (2 * math.pi / components)
            zero = torch.zeros(components)
            self.head.bias.copy_(torch.cat((zero, angle.cos(), angle.sin(), zero)))

    def forward(self, features: Tensor) -> Tensor:
        """From features (n, 8) to weights, cosines, sines and scales (n, 4 components)."""
        x = features
        for layer in self.layers:
            x = nn.functional.silu(layer(x))
        k = self.components
        return self.head(x) + nn.functional.pad(self.skip(features), (k, k))


class IkFlowNetwork(nn.Module):
    """The flow as a differentiable function of configuration and pose.

    Args:
        shape: Sizes of the networks.
    """

    def __init__(self, shape: FlowShape) -> None:
        super().__init__()
        self.shape = shape
        self.factors = nn.ModuleList(
            JointFactor(k, hidden) for k, hidden in zip(shape.components, shape.hidden, strict=True)
        )

    def forward(self, q: Tensor, X_WF: Tensor) -> tuple[Tensor, Tensor]:
        """From configurations to latents.

        Args:
            q: Joint positions (n, 7) inside the limits [rad].
            X_WF: Flange poses (n, 4, 4) [m].

        Returns:
            Latents (n, 7) in the unit cube, and for every joint the logarithm of ``du_i/dq_i``
            (n, 7): their sum is the log determinant of the Jacobian and the log density of ``q``.
        """
        rows = list(X_WF[:, :3].unbind(1))
        latents, densities = [], []
        for joint, factor in enumerate(self.factors):
            features, azimuth = _features(rows, joint)
            limit = float(IIWA_7.upper[joint])
            head = factor(features)
            u, log_density = _mixture(head, self.shape.narrowest, azimuth, limit, q[:, joint])
            latents.append(u)
            densities.append(log_density)
            _turn(rows, joint, q[:, joint])
        return torch.stack(latents, 1), torch.stack(densities, 1)


def _features(rows: list[Tensor], joint: int) -> tuple[Tensor, Tensor]:
    """As `ik_flow_layers.features_kernel`; ``rows`` are those of the targets."""
    a, b, c = (int(row) for row in PLANES[joint])
    step = rows[2].new_tensor([0.0, 0.0, 0.0, float(STEPS[joint])])
    rows[2] = rows[2] - step
    column = int(REFERENCES[joint])
    azimuth = torch.atan2(rows[b][:, column], rows[a][:, column] + _TINY)
    cos, sin = torch.cos(azimuth)[:, None], torch.sin(azimuth)[:, None]
    along, across = cos * rows[a] + sin * rows[b], cos * rows[b] - sin * rows[a]
    position = torch.stack((along[:, 3], rows[c][:, 3]), 1) / LENGTH_SCALE
    axes = (along[:, :3:2], across[:, :3:2], rows[c][:, :3:2])
    return torch.cat((position, *axes), 1), azimuth


def _turn(rows: list[Tensor], joint: int, q: Tensor) -> None:
    """As `feasigrasp_lab.paper.ik_flow_layers.turn_kernel`; replaces entries of ``rows``."""
    a, b, _ = (int(row) for row in PLANES[joint])
    cos, sin = torch.cos(q)[:, None], torch.sin(q)[:, None]
    rows[a], rows[b] = cos * rows[a] + sin * rows[b], cos * rows[b] - sin * rows[a]


def _mixture(
    head: Tensor, narrowest: float, azimuth: Tensor, limit: float, q: Tensor
) -> tuple[Tensor, Tensor]:
    """Cumulative distribution and log density (n,) of a joint's mixture between its limits."""
    weight, cos, sin, scale = head.chunk(4, dim=1)
    log_weight = torch.log_softmax(weight, dim=1)
    centre = azimuth[:, None] + torch.atan2(sin, cos + _TINY)
    scale = narrowest + (WIDEST - narrowest) * torch.sigmoid(scale + SCALE_BIAS)
    whole = torch.tanh(0.5 * math.pi / scale)  # mass of a logistic distribution on the circle
    share = (1.0 - BACKGROUND) * torch.exp(log_weight) / whole
    d, first, last = (_wrapped(angle - centre) for angle in (q[:, None], -limit, limit))
    start = torch.sigmoid(first / scale)
    mass = share * (torch.sigmoid(d / scale) - start + whole * (d < first))
    inside = share * (torch.sigmoid(last / scale) - start + whole * (last < first))
    norm = inside.sum(1) + BACKGROUND
    u = (mass.sum(1) + BACKGROUND * (q + limit) / (2.0 * limit)) / norm
    z = torch.abs(d) / scale
    log_logistic = -z - torch.log(scale) - 2.0 * torch.log1p(torch.exp(-z))
    log_density = torch.logsumexp(torch.log(share) + log_logistic, 1)
    background = log_density.new_tensor(math.log(BACKGROUND / (2.0 * limit)))
    return u, torch.logaddexp(log_density, background) - torch.log(norm)


def _wrapped(angle: Tensor) -> Tensor:
    return torch.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


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
    return IkFlow(network.shape, network_arrays(network))


def held_out_metrics(network: IkFlowNetwork, q: Array, X_WF: Array) -> dict[str, float]:
    """Negative log likelihood of configurations, and how well samples reach their poses."""
    device = next(network.parameters()).device
    with torch.no_grad():
        density = -network(_tensor(q, device), _tensor(X_WF, device))[1].double().mean(0)
    flow = export(network)
    sample = flow.sample(X_WF)
    _, position, angle = refine(X_WF, sample, 0, DAMPING)
    _, refined_position, refined_angle = refine(X_WF, sample, 3, DAMPING)
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
    """One training run; the weights with the best held-out likelihood are kept."""

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
    warm_up, least, averaged_over, largest_gradient = 200, 1e-3, 1, 5.0

    def __init__(self, args: argparse.Namespace, shape: FlowShape) -> None:
        sizes = json.loads(json.dumps(asdict(shape)))  # lists, as earlier checkpoints have them
        identity = {"seed": args.seed, "batch": args.batch, "shape": sizes}
        torch.manual_seed(args.seed)
        optimizer = torch.optim.Adam, {"lr": args.learning_rate}
        super().__init__(args, IkFlowNetwork(shape), optimizer, identity)
        self.clipped = self.network.factors
        # Entry of the random seed that keeps the held-out poses apart from all batches.
        self.held_out = training_batch(np.random.default_rng([args.seed, 2**32 - 1]), args.held_out)

    def losses(self) -> dict[str, Tensor]:
        """The negative log likelihood of new samples."""
        rng = np.random.default_rng([self.args.seed, self.step])
        q, X_WF = (_tensor(part, self.args.device) for part in training_batch(rng, self.args.batch))
        return {"nll": -self.network(q, X_WF)[1].mean(0).sum()}

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
