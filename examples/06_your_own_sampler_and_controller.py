"""Puts a sampler and a controller of one's own into the whole diagram, and compares with ours."""

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps import AntipodalSampler
from feasigrasp.models.reach import Reachability
from feasigrasp.models.robot import pose_and_jacobian
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import GraspController, make_dynamic_grasp
from feasigrasp.systems.metrics import SAMPLE_NAMES

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/06_your_own_parts.png")


def narrowest(gpdf):
    """A sampler is any function of the object's field that returns grasps in the object frame."""
    grasps = AntipodalSampler()(gpdf)
    return grasps.select(np.argsort(grasps.width)[:20], "wider than others")


class FirstGrasp(GraspController):
    """Goes straight to the first grasp, and forgets that the object moves."""

    def update(self, memory, inputs):
        return inputs.grasps.X_OG[:1]

    def velocity(self, memory, inputs):
        if memory is None or len(memory) == 0:
            return self.enforced(np.zeros(7), inputs)  # the safety QP brakes
        X_WH, J_WH = pose_and_jacobian(inputs.q, self.reachability.gripper.X_FG)
        X_WT = inputs.X_WO @ memory[0]
        turn = se3.so3_log(X_WT[:3, :3] @ X_WH[:3, :3].T)
        V_WT = 2.0 * np.concatenate([turn, X_WT[:3, 3] - X_WH[:3, 3]])
        return self.enforced(np.linalg.pinv(J_WH, rcond=0.02) @ V_WT, inputs)


scenario = load_scenario("ReachLinearMocap", "{object: {model: mustard_bottle}}")
own: dict[str, Any] = {"sampler": narrowest, "controller": FirstGrasp(Reachability())}
figure, ax = plt.subplots(figsize=(7, 3.6))
for name, parts in {"ours": {}, "own sampler and controller": own}.items():
    diagram = make_dynamic_grasp(scenario, **parts)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(3.0)
    log = diagram.GetSubsystemByName("log(metrics)").FindLog(simulator.get_context())
    error = 100 * log.data()[SAMPLE_NAMES.index("grasp_position_error")]
    print(f"{name}: {np.nanmean(error[-50:]):.1f} cm from the nearest grasp in the last second")
    ax.plot(log.sample_times(), error, label=name)
ax.set(xlabel="time [s]", ylabel="hand to nearest grasp [cm]", ylim=(0, None))
ax.legend()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90, bbox_inches="tight")
