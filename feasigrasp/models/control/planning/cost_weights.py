"""Cost weights of planning, in seconds: running cost, terminal cost and penalties.

The unit is a second without the object: a second during which the hand is `CostWeights.lost` away
from the object's middle costs 1 s, at half of that distance 0.5 s. Everything else is what a second
of it, or its happening once, is worth in this currency. Radians would mean something else for every
joint and every hand; time is what a controller loses by a wrong choice, and what the joints' speed
limits turn every way into.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, record
from feasigrasp.models.compiled import compiled
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability_kernel

#: Scores below this count as this, and a grasp counts as rarer than the densest by no more [nat].
#: Source: guessed.
LEAST_SCORE, RAREST = 0.05, 15.0


@dataclass(frozen=True)
class CostWeights:
    """Instants of the prediction horizon and weights of the cost terms.

    Attributes:
        times: Instants that are looked at, from now on [s].
        lost: Distance of hand and object that costs a second per second [m].
        score: Of a grasp whose score is less by a factor of e, per second.
        density: Of a grasp at which the density of the grasps is less by a factor of e, per second.
        manipulability: Manipulability below which there is a penalty [m^3].
        manipulability_cost: Of no manipulability at all, per second.
        limit_zone: Distance to a joint limit below which there is a penalty [rad].
        limit_cost: Of a joint at its limit, per second.
        end: Terminal cost of a candidate path that ends at once [s]; it falls to zero over
            `expiry_horizon`.
        expiry_horizon: Duration of a candidate path without terminal cost [s].
        collision: Of every point of the straight path to a candidate that collides [s].
        no_corridor: Of a grasp behind which a joint limit leaves no place to line up [s].
        motion: Of joint motion, per second of it at the speed limits.
        waiting: Of being at a place before the grasp is, per second.
        speed_share: Share of the joints' speed limits that a way is planned with.
        follow_share: Share of them that following a grasp may take: what the safety problem allows,
            since a grasp that is followed as well as the arm can is better than none.
        regrip_time: Time that going round the object takes at most, beside that of the joints [s].
    """

    times: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.0, 9.0)
    lost: float = 0.1
    score: float = 1.0
    density: float = 0.02
    manipulability: float = 0.12
    manipulability_cost: float = 0.5
    limit_zone: float = 0.2
    limit_cost: float = 0.2
    end: float = 10.0
    expiry_horizon: float = 16.0
    collision: float = 2.0
    no_corridor: float = 0.0
    motion: float = 0.2
    waiting: float = 0.5
    speed_share: float = 0.7
    follow_share: float = 0.9
    regrip_time: float = 0.5

    @classmethod
    def to_grasp_soon(cls) -> CostWeights:
        """For a hand that closes as soon as it is there.

        Then it does not matter where a candidate path ends later on, only that it lasts until the
        object is held; to wait for a better one is worth less; and it matters that the hand can
        line up. One that follows for ever would leave a grasp early for where there is more room.
        """
        times = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
        return cls(times=times, expiry_horizon=3.0, waiting=3.0, no_corridor=3.0)

    @classmethod
    def for_joint_field(cls, horizon: float = 1.5) -> CostWeights:
        """For many candidates at once, each followed up to a horizon [s].

        What comes after an end is not looked at. A hand that closes soon needs to look less far
        than one that follows for ever, and has to unwind in time.
        """
        return cls(times=tuple(np.linspace(0.0, horizon, 9).tolist()), expiry_horizon=horizon)

    def grasp_rates(self, grasps: GraspSet, log_density: Array | None = None) -> Array:
        """Running cost of the grasps themselves, independent of the arm.

        Times a temperature, ``exp(-rate)`` is the weight ``density * score`` of a grasp: weights of
        logarithms are exponents of weights.

        Args:
            grasps: The grasps, n of them.
            log_density: Log density of all grasps at each, shape (n,); without it none is rarer.

        Returns:
            Shape (n,); that of a certain grasp at the object's middle, where grasps are densest, is
            zero.
        """
        rates = np.linalg.norm(grasps.X_OG[:, :3, 3], axis=1) / self.lost
        rates += self.score * -np.log(np.clip(grasps.score, LEAST_SCORE, 1.0))
        if log_density is not None and len(grasps):
            rates += self.density * np.minimum(log_density.max() - log_density, RAREST)
        return np.asarray(rates)

    @cached_property
    def instants(self) -> Array:
        """``times`` as an array."""
        return np.array(self.times)

    def instants_from(self, time: float, interception_time: float) -> Array:
        """Instants of a plan from a time on: now, a fixed grid, and the interception time.

        What is due then does not recede from plan to plan.

        Args:
            time: Now [s].
            interception_time: When something is due that was planned before [s].
        """
        step = self.times[1]
        gone = time - step * np.floor(time / step + 1e-3)  # no instant is next to now
        times = np.concatenate([[0.0], self.instants[1:] - gone])
        if interception_time > time:
            times[instant_at(interception_time - time, times)] = interception_time - time
        return times

    @cached_property
    def record(self) -> NDArray[np.void]:
        """The rest for kernels."""
        return record(self)


def instant_at(left: float, times: Array) -> int:
    """Index of the instant nearest to a time from now [s], except now itself."""
    return 1 + int(np.argmin(np.abs(times[1:] - left)))


@compiled
def running_cost_kernel(q, grasp_rate, costs):
    """Running cost of a configuration at a grasp with running cost ``grasp_rate``."""
    lack = max(0.0, 1.0 - manipulability_kernel(q) / costs.manipulability)
    rate = grasp_rate + costs.manipulability_cost * lack
    for i in range(IIWA_7.joints):
        inside = (IIWA_7.position_limits[i] - abs(q[i])) / costs.limit_zone
        if inside < 1.0:
            rate += costs.limit_cost * (1.0 - inside) ** 2
    return rate


@compiled(forceinline=True)
def terminal_cost_kernel(time, costs):
    """Terminal cost of a candidate path with a given time to its end [s]."""
    return costs.end * max(0.0, 1.0 - time / costs.expiry_horizon)
