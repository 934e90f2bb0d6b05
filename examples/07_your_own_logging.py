"""The whole diagram with a system and logs of one's own: the object's pose and joint speeds."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

import feasigrasp as fg
from feasigrasp.models.robot import IIWA_7

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/07_your_own_logging.png")


class PoseVector(LeafSystem):
    """A pose as a vector, which can be logged: its 4 x 4 matrix, row by row."""

    def __init__(self):
        super().__init__()
        self._pose = self.DeclareAbstractInputPort("pose", AbstractValue.Make(RigidTransform()))
        self.DeclareVectorOutputPort("X", 16, self._calc, {self._pose.ticket()})

    def _calc(self, context, output):
        output.SetFromVector(self._pose.Eval(context).GetAsMatrix4().ravel())


logs: dict[str, VectorLogSink] = {}


def connect(builder, subsystems):
    """Adds the system, and a log of it and of the drive, before the diagram is built."""
    vector = builder.AddSystem(PoseVector())
    builder.Connect(subsystems.tracker.GetOutputPort("object_pose"), vector.get_input_port())
    velocity = subsystems.drive.GetOutputPort("desired_velocity")
    logs["X_WO"] = LogVectorOutput(vector.get_output_port(), builder, 0.01)
    logs["qd"] = LogVectorOutput(velocity, builder, 0.01)


scenario = fg.load_scenario("ReachCircularMocap", "{object: {model: mustard_bottle}}")
simulator = Simulator(fg.make_dynamic_grasp(scenario, connect=connect))
simulator.AdvanceTo(3.0)

X_WO, qd = (log.FindLog(simulator.get_context()) for log in logs.values())
p_WO = X_WO.data().T.reshape(-1, 4, 4)[:, :3, 3]
print(f"the object was tracked over {np.ptp(p_WO[10:], axis=0).round(2)} m")
share = np.abs(qd.data().T) / IIWA_7.velocity_limits
print(f"joint speeds: {share.max():.0%} of their limits at most")
figure, axes = plt.subplots(1, 2, figsize=(10, 3.4))
axes[0].plot(X_WO.sample_times(), p_WO, label=["x", "y", "z"])
axes[0].set(xlabel="time [s]", ylabel="tracked position of the object [m]")
axes[0].legend()
axes[1].plot(qd.sample_times(), qd.data().T)
axes[1].set(xlabel="time [s]", ylabel="joint velocity [rad/s]")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
