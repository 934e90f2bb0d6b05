"""How the proposals of a grasp network are measured against labels."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.network.architectures import Heads
from feasigrasp_lab.training.grasp_batches import Examples
from feasigrasp_lab.training.grasp_losses import FREE, Labels, free_share, loss

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
    score, positive = errors["score"], errors["positive"]
    completed = ~true[positive > 0.5]
    valid = errors["approach_valid"][completed & (errors["sure"] > 0.5)]
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
        "width_mm": 1e3 * (heads.likeliest_width()[0] - labels.width)[mask].abs(),
        "closing_deg": torch.rad2deg(torch.arccos(cosine)),
        "approach_valid": free > FREE,
        "sure": torch.sigmoid(heads.contact[mask]) > 0.5,
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
