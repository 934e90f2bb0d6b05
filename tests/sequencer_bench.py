"""A gripper sequencer with inputs set by hand, for tests of it."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems.gripper_sequencer import GripperSequencer
from feasigrasp.systems.point_cloud_to_gpdf import Perceived
from feasigrasp.systems.ports import evaluate

GRIPPER = ParallelGripper()
CONFIG = GraspSequenceConfig(
    dwell=0.1,
    patience=3.0,
    squeeze_time=0.2,
    handover_time=0.0,
    lift=[-0.05, 0.0, 0.1],
    lift_time=0.3,
    shake=[0.0, 0.02, 0.0],
    shake_frequency=5.0,
    shake_time=0.4,
    hold_time=0.2,
)
Q = np.deg2rad([0.0, 20.0, 0.0, -80.0, 0.0, 70.0, 0.0])
X_WH = forward_kinematics(Q, GRIPPER.X_FG)
X_WO = RigidTransform(RollPitchYaw(0.3, 0.2, 1.0), [0.5, 0.1, 0.5])
#: The object's motion; the hand is carried along with it in this mock.
V_WO = np.array([0.1, -0.2, 0.3, 0.05, -0.1, 0.02])
UNKNOWN = RigidTransform(np.full((4, 4), np.nan))


def grasps_at(*errors):
    """One grasp for each error: where the hand is, moved by that much along its own x [m]."""
    X_OH = X_WO.inverse().GetAsMatrix4() @ X_WH
    poses = [X_OH @ RigidTransform([error, 0.0, 0.0]).GetAsMatrix4() for error in errors]
    n = len(poses)
    return GraspSet(np.array(poses).reshape(n, 4, 4), 0.04 + 0.001 * np.arange(n), np.ones(n))


class Mock:
    """A sequencer whose inputs are set by hand."""

    def __init__(self, config=CONFIG, looks=False, gives_up=False, **inputs):
        self.dut = GripperSequencer(config, GRIPPER, period=0.05, looks=looks, gives_up=gives_up)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(
            position=Q,
            grasps=grasps_at(0.05, 0.001, 0.1),
            object_pose=X_WO,
            object_velocity=SpatialVelocity(V_WO),
            gripper_state=[0.04, 0.0],
        )
        self.fix(**inputs)

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def output(self, name):
        value = evaluate(self.dut.GetOutputPort(name), self.context)
        return float(value[0]) if isinstance(value, np.ndarray) else value

    def advance(self, t):
        self.simulator.AdvanceTo(t)
        return Phase(int(self.output("phase")))

    def advance_to_phase(self, phase, limit=10.0):
        """Advances to just after the phase begins, in control periods."""
        while self.advance(self.context.get_time() + 0.005) != phase:
            assert self.context.get_time() < limit
        return self.context.get_time()


def tracked(state, age=0.0):
    return Value[object](Tracking(TrackingState(state), age))


def perceived(contradicted):
    return Value[object](Perceived(FusedCloud.empty(0.003), None, contradicted=contradicted))
