"""A tracker of one's own in the whole diagram: poses as they are measured, differences as twist."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from feasigrasp.models.geometry import se3
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import make_dynamic_grasp

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/08_your_own_tracker.png")


class LastTwoPoses(LeafSystem):
    """Keeps the last two measured poses: no filter, no prediction, no covariance."""

    def __init__(self, period=0.02):
        super().__init__()
        self._period = period
        self._pose = self.DeclareAbstractInputPort("pose", Value(RigidTransform()))
        self.DeclareDiscreteState(np.full(32, np.nan))  # not known: the arm waits
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._measure)
        self.DeclareAbstractOutputPort("object_pose", Value[RigidTransform], self._last)
        self.DeclareAbstractOutputPort("object_velocity", Value[SpatialVelocity], self._twist)

    def _measure(self, context, state):
        last = context.get_discrete_state_vector().value()[:16]
        new = self._pose.Eval(context).GetAsMatrix4().ravel()
        state.get_mutable_vector().SetFromVector(np.concatenate([new, last]))

    def _last(self, context, output):
        poses = context.get_discrete_state_vector().value().reshape(2, 4, 4)
        output.set_value(RigidTransform(poses[0]))

    def _twist(self, context, output):
        new, old = context.get_discrete_state_vector().value().reshape(2, 4, 4)
        turn = se3.so3_log(new[:3, :3] @ old[:3, :3].T)
        change = np.concatenate([turn, new[:3, 3] - old[:3, 3]])
        output.set_value(SpatialVelocity(change / self._period))


scenario = load_scenario("ReachLinearMocap")
for name, tracker in {"ours": None, "the last two poses": LastTwoPoses()}.items():
    diagram = make_dynamic_grasp(scenario, tracker=tracker)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.0)
    log = diagram.GetSubsystemByName("log(arm)").FindLog(simulator.get_context())
    speed = np.abs(log.data()[7:]).max(axis=0)  # rows: positions, then velocities of the joints
    plt.plot(log.sample_times(), speed, label=name)
    print(f"{name}: {speed.mean():.2f} rad/s in the mean")
plt.gca().set(xlabel="time [s]", ylabel="fastest joint [rad/s]")
plt.legend()
picture.parent.mkdir(parents=True, exist_ok=True)
plt.savefig(picture, dpi=90)
