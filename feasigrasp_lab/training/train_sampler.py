"""``feasigrasp train sampler``: train the network that proposes grasps.

It learns from the shards that `feasigrasp_lab.training.train_sampler_data` makes, whole clouds of
points. Families of shapes that are held out are never trained on: they judge. What is judged,
exported and shipped are the running means of the weights; start the same command again to resume.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from feasigrasp.models.arrays import Array
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.networks import Heads
from feasigrasp_lab.paper.grasp_network import NETWORKS
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.training.grasp_batches import (
    FREE,
    Examples,
    Labels,
    free_share,
    load_examples,
    loss,
)
from feasigrasp_lab.training.loop import (
    TrainingRun,
    add_data_argument,
    add_evaluation_arguments,
    add_loop_arguments,
    rows_of_step,
    without_denormals,
)

#: What `held_out_metrics` measures; the errors are those of completed surfaces.
METRICS = (
    "loss",
    "contact_ap_completed",
    "contact_ap_true",
    "width_mm",
    "closing_deg",
    "approach_valid_percent",
)


def held_out_metrics(preset: str, network: nn.Module, examples: Examples) -> dict[str, float]:
    """Loss and errors on examples; NaN where there is nothing to measure."""
    # Clouds at a time.
    chunk = 16
    found: dict[str, list[np.ndarray]] = {}
    losses, kinds = [], []
    device = next(network.parameters()).device
    with torch.inference_mode():
        for start in range(0, len(examples), chunk):
            rows = np.arange(start, min(start + chunk, len(examples)))
            contacts, labels = examples.batch(rows, device)
            heads = network(contacts)
            losses.append(len(rows) * float(loss(preset, heads, labels)[0]))
            for name, values in measures(heads, labels).items():
                found.setdefault(name, []).append(values)
            kinds.append(np.repeat(examples.true_surface[rows], labels.contact.shape[1]))
    errors = {name: np.concatenate(values) for name, values in found.items()}
    true = np.concatenate(kinds)
    score, positive = errors["score"], errors["positive"]
    completed = ~true[positive > 0.5]
    valid = errors["approach_valid"][completed & (errors["reliable"] > 0.5)]
    closing, width = (errors[name][completed] for name in ("closing_deg", "width_mm"))
    return {
        "loss": sum(losses) / len(examples),
        "contact_ap_completed": average_precision(score[~true], positive[~true]),
        "contact_ap_true": average_precision(score[true], positive[true]),
        "width_mm": float(np.median(width)) if len(width) else math.nan,
        "closing_deg": float(np.median(closing)) if len(closing) else math.nan,
        "approach_valid_percent": 100.0 * float(np.mean(valid)) if len(valid) else math.nan,
    }


def measures(heads: Heads, labels: Labels) -> dict[str, Array]:
    """Errors of single points.

    Returns:
        ``score`` and ``positive`` of all points; of the points where a grasp starts the errors
        ``width_mm`` and ``closing_deg``, and whether the best approach is ``approach_valid``.
    """
    mask = labels.contact
    cosine = (heads.closing[mask] * labels.closing[mask]).sum(-1).clamp(-1.0, 1.0)
    best = heads.free[mask].argmax(-1)
    approach = heads.approach[mask][torch.arange(len(best), device=best.device), best]
    truth = (part[mask] for part in (labels.closing, labels.across, labels.free))
    free = free_share(approach.unsqueeze(1), *truth).squeeze(1)
    found = {
        "score": heads.contact.flatten(),
        "positive": mask.flatten(),
        "width_mm": 1e3 * (heads.mode_width()[0] - labels.width)[mask].abs(),
        "closing_deg": torch.rad2deg(torch.arccos(cosine)),
        "approach_valid": free > FREE,
        "reliable": torch.sigmoid(heads.contact[mask]) > 0.5,
    }
    return {name: value.double().cpu().numpy() for name, value in found.items()}


def average_precision(score: Array, positive: Array) -> float:
    """Area under the curve of precision over recall, by steps; NaN with nothing positive."""
    if not positive.any():
        return math.nan
    order = np.argsort(-score, kind="stable")
    hits = np.cumsum(positive[order])
    # Points with the same score pass the threshold together.
    last = np.concatenate([np.diff(score[order]) != 0.0, [True]])
    precision = (hits / np.arange(1, len(hits) + 1))[last]
    recall = hits[last] / hits[-1]
    return float(np.sum(np.diff(recall, prepend=0.0) * precision))


#: What ``--quick`` trains on. Source: definition.
QUICK_EXAMPLES = 60


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--preset", choices=list(NETWORKS), default="default", help="Network to train."
    )
    add_data_argument(parser)
    add_run_arguments(parser, out="", jobs=False)
    parser.set_defaults(out=None)  # out/train_sampler/PRESET
    add_loop_arguments(parser, batch=16, rate=3e-3, of="clouds")
    parser.add_argument(
        "--points", type=positive, default=128, help="Labelled points of each cloud in the loss."
    )
    add_evaluation_arguments(parser, minutes_=40, every=200, patience=30, held_out=120)
    parser.add_argument("--quick", action="store_true", help="Train on a sample, for 1 minute.")


class Training(TrainingRun[nn.Module]):
    """One training run; the running means of the weights are what is judged and written.

    What decides which weights are kept is how well contacts are ranked. How sure probabilities are,
    which the loss counts as well, `feasigrasp fit certainty` mends.
    """

    weights = "grasp_network.npz"
    columns = (
        *("step", "minutes", "learning_rate"),
        *(f"train_{part}" for part in ("loss", "contact", "width", "closing", "approach")),
        *(f"held_out_{metric}" for metric in METRICS),
    )
    criterion = "held_out_contact_ap_completed"
    shown = (
        "AP {held_out_contact_ap_completed:.3f}, width {held_out_width_mm:.1f} mm, "
        "b {held_out_closing_deg:.1f} deg, a {held_out_approach_valid_percent:.0f} %"
    )

    def __init__(self, args: argparse.Namespace, examples: Examples, held_out: Examples) -> None:
        self.preset, self.examples, self.held_out = args.preset, examples, held_out
        identity = {
            "preset": str(args.preset),
            "seed": args.seed,
            "batch": args.batch,
            "examples": len(examples),
            "held_out": len(held_out),
        }
        optimizer = torch.optim.AdamW, {"lr": args.learning_rate, "weight_decay": 1e-3}
        network = NETWORKS[args.preset].untrained(args.seed).network
        super().__init__(args, network, optimizer, identity)

    def losses(self) -> dict[str, Tensor]:
        """The loss of a batch and its parts, at some points of each cloud."""
        seed = self.args.seed
        # Entry of the random seed that keeps the choice of points apart from that of examples.
        rng = np.random.default_rng([seed, self.step, 1])
        chosen = rows_of_step(len(self.examples), self.args.batch, seed, self.step)
        contacts, labels = self.examples.batch(chosen, self.args.device)
        points = rng.random(tuple(labels.contact.shape)).argsort(1)[:, : self.args.points]
        rows = torch.from_numpy(points).to(self.args.device)
        total, parts = loss(self.preset, self.network(contacts, rows), labels.chosen(rows))
        return {"loss": total, **parts}

    def measure(self) -> dict[str, float]:
        """See `held_out_metrics`."""
        found = held_out_metrics(self.preset, self.averaged, self.held_out)
        return {f"held_out_{name}": value for name, value in found.items()}

    def export(self) -> None:
        """Writes the running means."""
        NETWORKS[self.preset].of(self.averaged).save(self.folder / self.weights)


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Trains, or goes on with training."""
    if args.out is None:
        args.out = Path("out/train_sampler") / args.preset
    most = None
    if args.quick:
        most, args.held_out = QUICK_EXAMPLES, min(args.held_out, QUICK_EXAMPLES // 2)
        args.default_minutes = 1.0
    examples, held_out = load_examples(args.data, args.seed, args.held_out, most)
    return Training(args, examples, held_out).run()
