"""A controller with inputs set by hand, for tests of all."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp_lab.baselines.nearest_grasp_controller import NearestGraspController

REACH = Reachability()
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
NEAR = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
FAR = RigidTransform([3.0, 0.0, 0.5])
UNKNOWN = RigidTransform(np.full((4, 4), np.nan))
STILL = SpatialVelocity.Zero()

every = pytest.mark.parametrize(
    "make", [RMMTaskController, GPJointController, NearestGraspController]
)


def ring(n=16):
    """Grasps round the object with many approach directions."""
    poses = [
        RigidTransform(
            RotationMatrix(RollPitchYaw(2 * np.pi * k / n, 0.7 * k, 0.3)), [0, 0, 0.01 * k - 0.08]
        ).GetAsMatrix4()
        for k in range(n)
    ]
    return GraspSet(np.array(poses), np.full(n, 0.04), np.ones(n))


class Bench:
    """A controller with inputs set by hand, after its first update."""

    def __init__(self, make, *, grasps=None, q=HOME, pose=NEAR, velocity=STILL, **kwargs):
        self.dut = make(REACH, **kwargs)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(
            position=q,
            grasps=ring() if grasps is None else grasps,
            object_pose=pose,
            object_velocity=velocity,
        )
        self.advance(0.001)

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def advance(self, t):
        self.simulator.AdvanceTo(t)

    def command(self):
        return self.dut.GetOutputPort("commanded_velocity").Eval(self.context).copy()
