"""A controller by itself, fed with inputs that change at every step."""

from __future__ import annotations

import time
from itertools import cycle

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import forward_kinematics

#: Where the arm is [rad].
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
#: Where the object is, and its twist [angular; linear].
X_WO = se3.make_pose(se3.so3_exp([0.2, -0.1, 0.4]), [0.5, 0.0, 0.5])
V_WO = np.array([0.1, 0.0, 0.2, 0.1, 0.0, 0.0])
#: Groups of grasps are this far apart, in radians and tenths of a metre.
_APART, _PER_METRE = 1.0, np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
#: Different inputs that follow one another.
_INPUTS = 64
#: Updates of a controller, at 10 Hz, for which grasps stay the same.
_UPDATES_PER_VIEW = 5
#: Updates that are not timed, since the first ones load compiled code.
_WARM_UP = 15


def grasps_in_reach(
    reachability: Reachability, n_groups: int, per_group: int, rng: np.random.Generator
) -> GraspSet:
    """Groups of grasps that the arm reaches.

    Args:
        reachability: Tells what can be reached.
        n_groups: Number of groups; they are well apart in orientation and position.
        per_group: Grasps in each, which differ by some millimetres and degrees.
        rng: Draws them.
    """
    X_FG = reachability.gripper.X_FG
    centers: list[Array] = []
    groups: list[Array] = []
    while len(groups) < n_groups:
        center = forward_kinematics(HOME + rng.uniform(-0.9, 0.9, len(HOME)), X_FG)
        gaps = [se3.log(se3.inverse(center) @ other) for other in centers]
        if any(np.linalg.norm(gap * _PER_METRE) < _APART for gap in gaps):
            continue
        spread = rng.normal(0.0, 1.0, (2 * per_group, 6)) * ([0.03] * 3 + [0.003] * 3)
        X_WG = center @ se3.exp(spread)
        X_WG = X_WG[reachability.reachable(X_WG)][:per_group]
        if len(X_WG) == per_group:
            centers.append(center)
            groups.append(X_WG)
    X_OG = se3.inverse(X_WO) @ np.concatenate(groups)
    return GraspSet(X_OG, np.full(len(X_OG), 0.05), rng.uniform(0.5, 1.0, len(X_OG)))


class ControllerProbe:
    """A controller after its first update, and inputs to evaluate its output with."""

    def __init__(self, controller: LeafSystem, grasps: GraspSet, rng: np.random.Generator) -> None:
        """Fixes the inputs of a controller and lets it take up the grasps."""
        self.controller = controller
        self.simulator = Simulator(controller)
        self.context = self.simulator.get_mutable_context()
        fixed = {
            name: controller.GetInputPort(name).FixValue(self.context, value)
            for name, value in {
                "position": HOME,
                "grasps": grasps,
                "object_pose": RigidTransform(X_WO),
                "object_velocity": SpatialVelocity(V_WO),
                "desired_velocity": np.zeros(len(HOME)),
            }.items()
        }
        self.simulator.Initialize()
        self.simulator.AdvanceTo(1e-3)
        self._output = controller.GetOutputPort("commanded_velocity")
        self._position, self._pose = fixed["position"], fixed["object_pose"]
        self._grasps = fixed["grasps"]
        few = rng.permutation(len(grasps))[: max(1, 4 * len(grasps) // 5)]
        self._views = cycle([grasps.select(np.sort(few)), grasps])
        poses = X_WO @ se3.exp(rng.normal(0.0, 0.01, (_INPUTS, 6)))
        self.inputs = list(
            zip(
                HOME + rng.normal(0.0, 0.05, (_INPUTS, len(HOME))),
                map(RigidTransform, poses),
                strict=True,
            )
        )
        self._next = cycle(self.inputs)

    def next_inputs(self) -> tuple[Array, RigidTransform]:
        """Joint positions (7,) and object pose that have not just been used."""
        return next(self._next)

    def step(self) -> Array:
        """The command for the next inputs, shape (7,)."""
        self._move_on()
        command: Array = self._output.Eval(self.context)
        return command

    def update_ms(self, period: float, count: int) -> Array:
        """Processor time of updates that follow one another [ms], shape (count,).

        Arm and object are elsewhere at every update, and grasps are others at every fifth: there
        are two views in a second.

        Args:
            period: Time between updates of the controller [s].
            count: Number of updates.
        """
        times = []
        for k in range(_WARM_UP + count):
            self._move_on()
            if k % _UPDATES_PER_VIEW == 0:
                self._grasps.GetMutableData().set_value(next(self._views))
            start = time.process_time()
            self.simulator.AdvanceTo(self.context.get_time() + period)
            times.append(1e3 * (time.process_time() - start))
        return np.array(times[_WARM_UP:])

    def _move_on(self) -> None:
        q, pose = self.next_inputs()
        self._position.GetMutableData().set_value(q)
        self._pose.GetMutableData().set_value(pose)
