"""A hand of one's own in the whole diagram: described in a file, which the scenario names."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from feasigrasp.scenario import load_scenario
from feasigrasp.systems import make_dynamic_grasp

picture = Path(
    sys.argv[1] if len(sys.argv) > 1 else "out/examples/09_your_own_gripper_in_the_diagram.png"
)
picture.parent.mkdir(parents=True, exist_ok=True)

# In metres, in the grasp frame G; what is not given is as on the packaged hand. The simulated hand
# is made of it, too: `feasigrasp run ReachLinearMocap --scenario-text '{gripper: slim.yaml}'`.
hand = picture.with_name("slim.yaml")
hand.write_text("max_opening: 0.10\nfinger_width: 0.020\nfinger_thickness: 0.010\ntip: 0.030\n")

text = f"{{gripper: {hand}, object: {{model: mustard_bottle}}}}"
scenario = load_scenario("ReachLinearMocap", text)
sinks: list[VectorLogSink] = []


def connect(builder, subsystems):
    """Logs the distance between the pads."""
    state = subsystems.station.GetOutputPort("gripper.state_measured")
    sinks.append(LogVectorOutput(state, builder, 0.01))


diagram = make_dynamic_grasp(scenario, connect=connect)
simulator = Simulator(diagram)
simulator.AdvanceTo(5.0)

status = diagram.subsystems.status
for each in status.history(status.GetMyContextFromRoot(simulator.get_context())):
    print(f"{each.time:5.2f} s  {each.code} {each.detail}")
log = sinks[0].FindLog(simulator.get_context())
figure, axes = plt.subplots(figsize=(6, 3))
axes.plot(log.sample_times(), 1e3 * log.data()[0])
axes.set(xlabel="time [s]", ylabel="between the pads [mm]")
figure.tight_layout()
figure.savefig(picture, dpi=90)
