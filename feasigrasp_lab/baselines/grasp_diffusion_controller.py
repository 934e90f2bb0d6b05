"""Baseline controller: gradient of the energy of grasps as the hand's twist."""

from __future__ import annotations

import numpy as np
import torch

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.ports import declare_output
from feasigrasp_lab.baselines.diffusion_law import (
    GRADIENT_GAIN,
    RATE,
    DiffusedField,
    DiffusionControlOptions,
    diffusion_velocity,
)
from feasigrasp_lab.baselines.grasp_diffusion import (
    GraspDiffusion,
    load_grasp_diffusion,
)
from feasigrasp_lab.baselines.nearest_law import (
    NearestOptions,
    nearest_grasp,
    nearest_grasp_velocity,
)
from feasigrasp_lab.paper.controllers import Unenforced
from feasigrasp_lab.paper.options import Law, PaperOptions


def make_controller(
    scenario: Scenario, reachability: Reachability, safety: SafetyOptions
) -> GraspDiffusionController:
    """The controller ``diffusion`` of a scenario."""
    given = PaperOptions.of(scenario)
    options = DiffusionControlOptions(
        law=given.law,
        gain=given.gain or (GRADIENT_GAIN if given.law == Law.GRADIENT else RATE),
        damping=given.damping,
        feed_forward=given.feed_forward,
    )
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
        options: DiffusionControlOptions | None = None,
        *,
        diffusion: GraspDiffusion | None = None,
        safety: SafetyOptions | None = None,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A controller that descends an energy.

        Args:
            reachability: Test, with the hand on the flange.
            options: Law and gains.
            diffusion: The energy; by default the one that comes with the package.
            safety: Margins of the QP.
            period: Time between updates [s].

        Raises:
            WeightsError: The energy's weights are missing or broken.
        """
        super().__init__(reachability, DiffusedField(), safety=safety, period=period)
        self._options = options or DiffusionControlOptions()
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
            near = NearestOptions(feed_forward=options.feed_forward)
            qd = nearest_grasp_velocity(q, memory.grasp, X_WO, V_WO, self.reachability, near)
            return self.enforced(qd, inputs)
        X_FG = self.reachability.gripper.X_FG
        qd, J, V = diffusion_velocity(q, memory, X_WO, V_WO, X_FG, options)
        return self.enforced(qd, inputs, J, V)


class _Unenforced(Unenforced, GraspDiffusionController):
    """The same with nothing enforced."""
