"""Baseline controller: descent of the energy of grasp diffusion.

The paper (arXiv 2311.02576, table II) drives the hand by the gradient of an SE(3) energy. The law
``gradient`` is that: gain times the gradient at the least noise, in rad and units of the energy's
length. ``preconditioned`` goes at a rate, by the gradient times the variance of the noise, which
falls as when samples are drawn: where there are no grasps near, an energy of little noise has
nothing.

The paper does not say when fingers close. Here they do where the energy ends: once its noise has
fallen, the way down it from the hand is followed to its end, and if something is between the pads
there, that is a grasp, centred and followed as those of the sampler are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.grasp_controller import ControllerInputs, GraspController
from feasigrasp.systems.ports import declare_output
from feasigrasp_lab.baselines.diffusion_energy import LENGTH
from feasigrasp_lab.baselines.diffusion_sampler import DiffusionSampler, closed_on
from feasigrasp_lab.baselines.grasp_diffusion import (
    LAST_TIME,
    DiffusedObject,
    GraspDiffusion,
    load_grasp_diffusion,
    noise_variance,
)
from feasigrasp_lab.baselines.nearest_grasp_controller import (
    MAX_ANGULAR,
    MAX_LINEAR,
    NearestGrasp,
    nearest_grasp,
    nearest_grasp_velocity,
)
from feasigrasp_lab.paper.modes import Unenforced
from feasigrasp_lab.paper.options import Law, PaperOptions
from feasigrasp_lab.paper.task_law import hand_twist_kernel, least_norm_kernel

#: The noise falls by this factor of its time from update to update, while the grasps are no farther
#: than so many of its standard deviations: the length of noise in six directions, and half as much
#: again. Source: guessed.
_COOLING, _FARTHEST = 0.85, 1.5 * np.sqrt(6.0)
#: From radians and units of the energy to radians and metres. Source: formula.
_UNITS = np.repeat([1.0, LENGTH], 3)
#: Rate of the law ``preconditioned`` [1/s]. Source: guessed.
RATE = 5.0
#: Gain of the ``gradient``: 5/s times the way that is left where the energy is that of noise of its
#: least deviation, 0.03. Source: reasoned.
GRADIENT_GAIN = 0.005


@dataclass(frozen=True, eq=False)
class DiffusedField(Frozen):
    """The energy of the present field; none while nothing is known.

    Attributes:
        gpdf: The field.
        diffused: Its energy.
        time: Noise level that is followed, from 1 down to `LAST_TIME`.
        grasp: Followed instead: where the energy ends, and, without a field, where to hold and to
            lift, once fingers close.
        arrival: The grasp where the energy ends, if the hand is near; else none.
    """

    gpdf: Gpdf | None = None
    diffused: DiffusedObject | None = None
    time: float = 1.0
    grasp: NearestGrasp = field(default_factory=NearestGrasp)
    arrival: GraspSet = field(default_factory=GraspSet.empty)

    def of(self, gpdf: Gpdf, diffusion: GraspDiffusion) -> DiffusedField:
        """The same for another field, encoded only if it is another one."""
        if gpdf is self.gpdf:
            return self
        diffused = diffusion.at(grasp_input(gpdf, DiffusionSampler.n_points))
        return DiffusedField(gpdf, diffused, self.time)

    def cooled(self, X_OH: Array) -> DiffusedField:
        """The same with less noise if the grasps are near for a hand, with more if they are far."""
        if self.diffused is None or not np.isfinite(X_OH).all():
            return self
        far = np.linalg.norm(self.way(X_OH) / _UNITS) / np.sqrt(noise_variance(self.time))
        factor = _COOLING if far <= _FARTHEST else 1.0 / _COOLING
        return replace(self, time=float(np.clip(self.time * factor, LAST_TIME, 1.0)))

    def arriving(
        self, X_OH: Array, q: Array, X_WO: Array, reachability: Reachability
    ) -> DiffusedField:
        """The same with the grasp at which the energy ends, if there is one, near and in reach.

        Args:
            X_OH: The hand in O, shape (4, 4).
            q: Joint positions [rad], shape (7,).
            X_WO: Object pose, shape (4, 4).
            reachability: Test of the pose, and the hand's opening.
        """
        arrival = self.arrival
        if len(arrival) == 0:
            arrival = self._end(X_OH, reachability.gripper.max_opening)
        # It is a grasp to go to while a hand is no farther from it [m], [rad].
        if (grasp_errors(arrival.X_OG, X_OH) > (0.05, 0.5)).any():
            arrival = GraspSet.empty()
        grasp = nearest_grasp(self.grasp, q, arrival.X_OG, X_WO, reachability)
        return replace(self, grasp=grasp, arrival=arrival if grasp else GraspSet.empty())

    def _end(self, X_OH: Array, opening: float) -> GraspSet:
        """Where the way down the energy ends; none with noise left, or nothing to hold there."""
        # The end of the way down the energy: in so many steps of that share of it.
        steps, share = 10, 0.3
        if self.gpdf is None or self.time > LAST_TIME or not np.isfinite(X_OH).all():
            return GraspSet.empty()
        X = X_OH
        for _ in range(steps):
            X = X @ se3.exp(share * self.way(X))
        X_OG, width, held = closed_on(self.gpdf, X[None], opening)
        reliable = np.ones(int(held.sum()))  # not judged, and its being there changes no other
        return GraspSet(X_OG[held], width[held], reliable, payload_score=reliable)

    def way(self, X_OH: Array) -> Array:
        """Variance of the noise times the gradient, downwards, at a hand pose (4, 4) in O.

        A hand beyond what noise reaches goes as from the nearest place that it does reach, after
        the way to there.

        Returns:
            Body twist [angular; linear], shape (6,) [rad; m].
        """
        # Distance from the center of an object that noise brings hands to [m].
        known = 0.35
        if self.diffused is None:
            return np.zeros(6)
        beside = X_OH[:3, 3] - self.diffused.middle
        back = beside * max(0.0, 1.0 - known / max(float(np.linalg.norm(beside)), known))
        X = X_OH.copy()
        X[:3, 3] -= back
        way = -noise_variance(self.time) * self.diffused.gradient(X[None], self.time)[0] * _UNITS**2
        way[3:] -= X_OH[:3, :3].T @ back
        return np.asarray(way)


def diffusion_velocity(
    q: Array, energy: DiffusedField, X_WO: Array, V_WO: Array, X_FG: Array, options: PaperOptions
) -> tuple[Array, Array, Array]:
    """Joint velocity down the energy by the damped pseudo-inverse, nothing enforced.

    Arguments as of `paper_task_space_velocity`, with the energy of the present field.

    Returns:
        Joint velocity [rad/s], shape (7,); the Jacobian, shape (6, 7), and the twist V_WH that it
        gives the hand, shape (6,). No motion without an energy, or if anything is not finite.
    """
    X_WH, J_WH = pose_and_jacobian(q, X_FG)
    J = np.ascontiguousarray(J_WH)
    known = np.isfinite(X_WO).all() and np.isfinite(V_WO).all()
    if energy.diffused is None or not known:
        return np.zeros(IIWA_7.joints), J, np.zeros(6)
    X_OH = se3.inverse(X_WO) @ X_WH
    if options.law == Law.GRADIENT:
        way = -energy.diffused.gradient(X_OH[None])[0] * _UNITS**2
        limits = np.inf, np.inf
    else:
        way = energy.way(X_OH)
        limits = MAX_ANGULAR, MAX_LINEAR
    V_O = np.array(V_WO if options.feed_forward else np.zeros(6), dtype=float)
    X_WO = np.ascontiguousarray(X_WO, dtype=float)
    V_WH = hand_twist_kernel(options.gain_or(RATE, GRADIENT_GAIN) * way, X_WH, X_WO, V_O, *limits)
    return least_norm_kernel(J, V_WH, float(options.damping)), J, V_WH


def make_controller(
    scenario: Scenario, reachability: Reachability, safety: SafetyOptions
) -> GraspDiffusionController:
    """The controller ``diffusion`` of a scenario."""
    options = PaperOptions.of(scenario)
    make = GraspDiffusionController if scenario.control.safe else _Unenforced
    return make(reachability, options, safety=safety, period=scenario.reachability.period)


class GraspDiffusionController(GraspController):
    """Descends the energy of grasp diffusion, of the object that the port ``gpdf`` describes.

    At every update the surface is encoded, if the field is another one; the memory is a
    `DiffusedField`. In between the command is a function of the inputs alone. On the way it looks
    at no grasps, only whether there are any in reach: without one the command is to stop, as it is
    while the object's pose or twist is not finite. Where the energy ends, with something between
    the pads, is a grasp of its own: the output port ``arrival``, a `GraspSet` of one or none, gives
    it. With the law ``gradient`` there is none. Without a field, as when fingers close and lift, it
    follows the grasp that it is given.

    Torch is set to one thread, which is best at control rate.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: PaperOptions | None = None,
        *,
        diffusion: GraspDiffusion | None = None,
        safety: SafetyOptions | None = None,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A controller that descends an energy, by default the one that comes with the package.

        Other arguments as of `GraspController`, and law and gains.
        """
        super().__init__(reachability, DiffusedField(), safety=safety, period=period)
        self._options = options or PaperOptions()
        self._diffusion = diffusion or load_grasp_diffusion()
        torch.set_num_threads(1)
        declare_output(
            self, "arrival", lambda context: self.memory(context).arrival, self.memory_tickets
        )
        self.warm_up()

    def update(self, memory: DiffusedField, inputs: ControllerInputs) -> DiffusedField:
        """The energy of the present field, and its noise."""
        grasps, gpdf, X_WO = inputs.grasps.X_OG, inputs.gpdf, inputs.X_WO
        if gpdf is None:
            held = nearest_grasp(memory.grasp, inputs.q, grasps, X_WO, self.reachability)
            return DiffusedField(grasp=held)
        X_OH = se3.inverse(X_WO) @ forward_kinematics(inputs.q, self.reachability.gripper.X_FG)
        field = memory.of(gpdf, self._diffusion).cooled(X_OH)
        if self._options.law == Law.GRADIENT:
            return field
        return field.arriving(X_OH, inputs.q, X_WO, self.reachability)

    def velocity(self, memory: DiffusedField, inputs: ControllerInputs) -> Array:
        """Down the energy."""
        q, X_WO, V_WO, options = inputs.q, inputs.X_WO, inputs.V_WO, self._options
        if len(inputs.grasps) == 0:
            return self.enforced(np.zeros(IIWA_7.joints), inputs)
        if memory.grasp:
            near = PaperOptions(feed_forward=options.feed_forward)
            qd = nearest_grasp_velocity(q, memory.grasp, X_WO, V_WO, self.reachability, near)
            return self.enforced(qd, inputs)
        X_FG = self.reachability.gripper.X_FG
        qd, J, V = diffusion_velocity(q, memory, X_WO, V_WO, X_FG, options)
        return self.enforced(qd, inputs, J, V)


class _Unenforced(Unenforced, GraspDiffusionController):
    """The same with nothing enforced."""
