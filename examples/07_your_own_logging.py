"""The whole diagram with a system and logs of one's own: manipulability and joint speeds."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from feasigrasp.models.robot import IIWA_7, manipulability
from feasigrasp.resources import diagram_path
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import make_dynamic_grasp

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/07_your_own_logging.png")


class Manipulability(LeafSystem):
    """Yoshikawa's measure of the arm's position."""

    def __init__(self):
        super().__init__()
        self._q = self.DeclareVectorInputPort("position", IIWA_7.joints)
        self.DeclareVectorOutputPort("w", 1, self._calc, {self._q.ticket()})

    def _calc(self, context, output):
        output.SetAtIndex(0, manipulability(self._q.Eval(context)))


scenario = load_scenario(
    diagram_path("dynamic.scenarios.yaml"),
    "ReachCircularMocap",
    "{object: {model: mustard_bottle}}",
)
logs: dict[str, VectorLogSink] = {}


def connect(builder, subsystems):
    """Adds the system, and a log of it and of the drive, before the diagram is built."""
    position = subsystems.station.GetOutputPort("iiwa.position_measured")
    measure = builder.AddSystem(Manipulability())
    builder.Connect(position, measure.get_input_port())
    velocity = subsystems.drive.GetOutputPort("desired_velocity")
    logs["manipulability"] = LogVectorOutput(measure.get_output_port(), builder, 0.01)
    logs["joint velocity [rad/s]"] = LogVectorOutput(velocity, builder, 0.01)


simulator = Simulator(make_dynamic_grasp(scenario, connect=connect))
simulator.AdvanceTo(6.0)

figure, axes = plt.subplots(1, 2, figsize=(10, 3.4))
for ax, (name, sink) in zip(axes, logs.items(), strict=True):
    log = sink.FindLog(simulator.get_context())
    ax.plot(log.sample_times(), log.data().T)
    ax.set(xlabel="time [s]", ylabel=name)
    print(f"{name}: {log.data().min():.3f} to {log.data().max():.3f}")
share = np.abs(logs["joint velocity [rad/s]"].FindLog(simulator.get_context()).data()).T
print(f"of the velocity limits: {(share / IIWA_7.velocity_limits).max():.0%} at most")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
