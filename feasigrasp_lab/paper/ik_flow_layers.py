"""Layers of the IK flow: sizes, joint frames, and compiled mixture quantiles.

See `feasigrasp_lab.paper.ik_flow` for the model as a whole. The kernels work on *targets*: the
first three rows (3, 4) of the flange pose that is left to reach, in the frame of the link reached
up to here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.iiwa import IIWA_7

#: Numbers that describe a target to the network of one joint. Source: layout: the network's
#: architecture.
FEATURES = 8
#: Positions enter the network in this unit [m]. Source: layout: input of the network.
LENGTH_SCALE = 0.5
#: Largest scale of a component [rad]. Source: guessed.
WIDEST = 1.5
#: Offset that lets scales start out at a fraction of the largest one. Source: guessed.
SCALE_BIAS = -2.0
#: Share of the uniform distribution in every mixture: keeps the density above zero. Source:
#: guessed.
BACKGROUND = 1e-5
#: Step along the local z-axis to joint i. Source: data sheet: KUKA LBR iiwa 7 R800.
STEPS = np.array(IIWA_7.link_steps[:-1])
#: Rows (a, b, c) of a target for each joint: it turns a towards b, about c. Source: layout.
PLANES = np.array(
    [(0, 1, 2) if axis[2] > 0 else (2, 0, 1) if axis[1] > 0 else (0, 2, 1) for axis in IIWA_7.axes]
)
#: Column of a target whose direction about the joint's axis is the zero of angles: the position,
#: but for the last joint, on whose axis the position lies, its x-axis. Source: layout.
REFERENCES = np.array([3] * (IIWA_7.joints - 1) + [0])


@dataclass(frozen=True)
class FlowShape:
    """Sizes of a flow.

    Attributes:
        components: Of the mixture of each joint, 7 entries.
        hidden: Widths of the hidden layers of each joint's network, 7 entries.
        narrowest: Least scale of a component [rad].
    """

    components: tuple[int, ...] = (24, 8, 4, 4, 4, 4, 2)
    hidden: tuple[tuple[int, ...], ...] = ((256, 256, 256),) * 2 + ((96, 96),) * 5
    narrowest: float = 1e-3

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> FlowShape:
        """From what `dataclasses.asdict` gives.

        Raises:
            KeyError: An entry is missing.
            TypeError: An entry is of another kind.
            ValueError: An entry makes no sense.
        """
        components = tuple(int(k) for k in content["components"])
        hidden = tuple(tuple(int(width) for width in widths) for widths in content["hidden"])
        narrowest = float(content["narrowest"])
        if len(components) != IIWA_7.joints or len(hidden) != IIWA_7.joints:
            raise ValueError(f"sizes of {IIWA_7.joints} joints are needed, one of each joint")
        if min(components) < 1 or any(min(widths, default=1) < 1 for widths in hidden):
            raise ValueError("a size is less than 1")
        if not 0.0 < narrowest < WIDEST:
            raise ValueError(f"the least scale is {narrowest}, not between 0 and {WIDEST} rad")
        return cls(components, hidden, narrowest)

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of all arrays of the networks, as `JointFactor` in torch names them."""
        shapes: dict[str, tuple[int, ...]] = {}
        for joint, (k, hidden) in enumerate(zip(self.components, self.hidden, strict=True)):
            sizes = (FEATURES, *hidden)
            for i in range(len(hidden)):
                shapes[f"factors.{joint}.layers.{i}.weight"] = (sizes[i + 1], sizes[i])
                shapes[f"factors.{joint}.layers.{i}.bias"] = (sizes[i + 1],)
            shapes[f"factors.{joint}.head.weight"] = (4 * k, sizes[-1])
            shapes[f"factors.{joint}.head.bias"] = (4 * k,)
            shapes[f"factors.{joint}.skip.weight"] = (2 * k, FEATURES)
        return shapes


@compiled
def wrapped(angle):
    """The same angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@compiled
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x)) if x >= 0.0 else 1.0 - 1.0 / (1.0 + math.exp(x))


@compiled
def features_kernel(target, joint, features, azimuth):
    """Moves targets (n, 3, 4) to a joint; writes features (n, 8) and azimuths (n,) about it."""
    a, b, c = PLANES[joint]
    column = REFERENCES[joint]
    for n in range(len(target)):
        T = target[n]
        T[2, 3] -= STEPS[joint]
        azimuth[n] = math.atan2(T[b, column], T[a, column])
        cos, sin = math.cos(azimuth[n]), math.sin(azimuth[n])
        features[n, 0] = (cos * T[a, 3] + sin * T[b, 3]) / LENGTH_SCALE
        features[n, 1] = T[c, 3] / LENGTH_SCALE
        for i in range(2):
            column_i = 2 * i  # the x- and the z-axis of the flange
            features[n, 2 + i] = cos * T[a, column_i] + sin * T[b, column_i]
            features[n, 4 + i] = cos * T[b, column_i] - sin * T[a, column_i]
            features[n, 6 + i] = T[c, column_i]


@compiled
def turn_kernel(target, joint, q):
    """Moves targets (n, 3, 4) to the frames behind a joint at angles q (n,)."""
    a, b, _ = PLANES[joint]
    for n in range(len(target)):
        T = target[n]
        cos, sin = math.cos(q[n]), math.sin(q[n])
        for i in range(4):
            T[a, i], T[b, i] = cos * T[a, i] + sin * T[b, i], cos * T[b, i] - sin * T[a, i]


# Rows of a joint's mixture (7, k): weight, centre, scale; the lower limit seen from the centre, the
# distribution there, and the masses of the whole component and of its part between the limits.
_WEIGHT, _CENTRE, _SCALE, _FIRST, _START, _WHOLE, _INSIDE = range(7)


@compiled
def _mixture(head, narrowest, azimuth, limit, mixture):
    """Writes the mixture (7, k) of a joint; returns the weight of its uniform background."""
    k = mixture.shape[1]
    largest = -np.inf
    for i in range(k):
        largest = max(largest, head[i])
    total, inside = 0.0, 0.0
    for i in range(k):
        weight = math.exp(head[i] - largest)
        total += weight
        centre = azimuth + math.atan2(head[2 * k + i], head[k + i])
        scale = narrowest + (WIDEST - narrowest) * _sigmoid(head[3 * k + i] + SCALE_BIAS)
        first, last = wrapped(-limit - centre), wrapped(limit - centre)
        mixture[_CENTRE, i], mixture[_SCALE, i], mixture[_FIRST, i] = centre, scale, first
        mixture[_START, i] = _sigmoid(first / scale)
        mixture[_WHOLE, i] = math.tanh(0.5 * math.pi / scale)
        past = mixture[_WHOLE, i] if last < first else 0.0
        mixture[_INSIDE, i] = _sigmoid(last / scale) - mixture[_START, i] + past
        mixture[_WEIGHT, i] = weight / mixture[_WHOLE, i]
        inside += mixture[_WEIGHT, i] * mixture[_INSIDE, i]
    # The background is a share of the mixture before the limits cut it.
    norm = (1.0 - BACKGROUND) * inside / total + BACKGROUND
    for i in range(k):
        mixture[_WEIGHT, i] *= (1.0 - BACKGROUND) / (total * norm)
    return BACKGROUND / norm


@compiled
def _cdf(q, limit, background, mixture):
    """Cumulative distribution and density [1/rad] of a joint's mixture at an angle."""
    u = background * (q + limit) / (2.0 * limit)
    density = background / (2.0 * limit)
    for i in range(mixture.shape[1]):
        weight, scale = mixture[_WEIGHT, i], mixture[_SCALE, i]
        d = wrapped(q - mixture[_CENTRE, i])
        e = math.exp(-abs(d) / scale)
        part = 1.0 / (1.0 + e)
        density += weight * e * part * part / scale
        share = (part if d >= 0.0 else e * part) - mixture[_START, i]
        u += weight * (share + mixture[_WHOLE, i] if d < mixture[_FIRST, i] else share)
    return u, density


@compiled
def _first_guess(u, limit, mixture, order):
    """About the angle where the distribution is u: exact if the components lie apart."""
    k = mixture.shape[1]
    for i in range(k):  # by insertion, from low to high centres
        j = i
        while j > 0 and wrapped(mixture[_CENTRE, order[j - 1]]) > wrapped(mixture[_CENTRE, i]):
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
    below = 0.0
    for j in range(k):
        i = order[j]
        mass = mixture[_WEIGHT, i] * mixture[_INSIDE, i]
        if below + mass >= u:
            share = mixture[_START, i] + mixture[_INSIDE, i] * (u - below) / mass
            if share >= 0.5 * (1.0 + mixture[_WHOLE, i]):
                share -= mixture[_WHOLE, i]
            share = min(max(share, 1e-12), 1.0 - 1e-12)
            d = mixture[_SCALE, i] * math.log(share / (1.0 - share))
            return min(max(wrapped(mixture[_CENTRE, i] + d), -limit), limit)
        below += mass
    return limit


@compiled
def quantile_kernel(head, narrowest, azimuth, limit, u, q):
    """From latents to angles of a joint: Newton's method, kept between bounds by bisection.

    Args:
        head: Outputs of the joint's network (n, 4 k): weights, cosines, sines, scales.
        narrowest: Least scale [rad].
        azimuth: Where the network's angles start (n,) [rad].
        limit: Angles are from -limit to limit [rad].
        u: Latents (n,).
        q: Out: angles (n,) [rad].
    """
    mixture = np.empty((7, head.shape[1] // 4))
    order = np.empty(mixture.shape[1], dtype=np.int64)
    for n in range(len(q)):
        background = _mixture(head[n], narrowest, azimuth[n], limit, mixture)
        low, high = -limit, limit
        x = _first_guess(u[n], limit, mixture, order)
        before = np.inf
        for _ in range(100):
            value, density = _cdf(x, limit, background, mixture)
            if value < u[n]:
                low = x
            else:
                high = x
            step = (u[n] - value) / density
            # Newton where it stays inside and at least halves the step, else bisection.
            inside = low <= x + step <= high and abs(step) < 0.5 * before
            following = x + step if inside else 0.5 * (low + high)
            before = abs(following - x)
            x = following
            # Angles are inverted to this accuracy [rad].
            if before < 1e-10:
                break
        q[n] = x
