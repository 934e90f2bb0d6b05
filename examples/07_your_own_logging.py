"""The whole diagram with a system and logs of one's own: manipulability and joint speeds."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.models.robot import IIWA_7, manipulability
from feasigrasp.resources import diagram_path
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import add_dynamic_grasp

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
    diagram_path("dynamic.scenarios.yaml"), "ReachCircular", "{object: {model: mustard_bottle}}"
)
builder = DiagramBuilder()
add_dynamic_grasp(builder, scenario)
station, drive = (builder.GetSubsystemByName(name) for name in ("station", "drive"))
measure = builder.AddSystem(Manipulability())
builder.Connect(station.GetOutputPort("iiwa.position_measured"), measure.get_input_port())
logs = {
    "manipulability": LogVectorOutput(measure.get_output_port(), builder, 0.01),
    "joint velocity [rad/s]": LogVectorOutput(
        drive.GetOutputPort("desired_velocity"), builder, 0.01
    ),
}
diagram = builder.Build()
simulator = Simulator(diagram)
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
