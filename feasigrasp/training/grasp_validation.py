"""How the proposals of a grasp network are measured against labels."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.network.architectures import Heads
from feasigrasp.training.grasp_batches import Examples
from feasigrasp.training.grasp_losses import FREE, Labels, free_share, loss

#: What `held_out_metrics` measures; the errors are those of completed surfaces.
METRICS = (
    "loss",
    "contact_ap_completed",
    "contact_ap_true",
    "width_mm",
    "closing_deg",
    "approach_valid_percent",
)
#: Clouds at a time.
_CHUNK = 16


def held_out_metrics(preset: str, network: nn.Module, examples: Examples) -> dict[str, float]:
    """Loss and errors on examples; NaN where there is nothing to measure."""
    found: dict[str, list[np.ndarray]] = {}
    losses, kinds = [], []
    device = next(network.parameters()).device
    with torch.inference_mode():
        for start in range(0, len(examples), _CHUNK):
            rows = np.arange(start, min(start + _CHUNK, len(examples)))
            contacts, labels = examples.batch(rows, device)
            heads = network(contacts)
            losses.append(len(rows) * float(loss(preset, heads, labels)[0]))
            for name, values in measures(heads, labels).items():
                found.setdefault(name, []).append(values)
            kinds.append(np.repeat(examples.true_surface[rows], labels.contact.shape[1]))
    errors = {name: np.concatenate(values) for name, values in found.items()}
    true = np.concatenate(kinds)
    completed = ~true[errors["positive"] > 0.5]
    sure = completed & (errors["sure"] > 0.5)
    ap = {
        kind: average_precision(errors["score"][rows], errors["positive"][rows])
        if errors["positive"][rows].any()
        else math.nan
        for kind, rows in (("completed", ~true), ("true", true))
    }
    return {
        "loss": sum(losses) / len(examples),
        "contact_ap_completed": ap["completed"],
        "contact_ap_true": ap["true"],
        "width_mm": _median(errors["width_mm"][completed]),
        "closing_deg": _median(errors["closing_deg"][completed]),
        "approach_valid_percent": 100.0 * _mean(errors["approach_valid"][sure]),
    }


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else math.nan


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
        "width_mm": 1e3 * (heads.likeliest_width()[0] - labels.width)[mask].abs(),
        "closing_deg": torch.rad2deg(torch.arccos(cosine)),
        "approach_valid": free > FREE,
        "sure": torch.sigmoid(heads.contact[mask]) > 0.5,
    }
    return {name: value.double().cpu().numpy() for name, value in found.items()}


def average_precision(score: Array, positive: Array) -> float:
    """Area under the curve of precision over recall, by steps, as the threshold falls."""
    order = np.argsort(-score, kind="stable")
    hits = np.cumsum(positive[order])
    # Points with the same score pass the threshold together.
    last = np.concatenate([np.diff(score[order]) != 0.0, [True]])
    precision = (hits / np.arange(1, len(hits) + 1))[last]
    recall = hits[last] / max(hits[-1], 1.0)
    return float(np.sum(np.diff(recall, prepend=0.0) * precision))
