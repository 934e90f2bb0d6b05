"""Places the arm at a grasp without a path, as in the paper's static test."""

import numpy as np
from pydrake.systems.analysis import Simulator, SimulatorStatus

from feasigrasp.models.reach.reachability import Reachability


def teleport(simulator: Simulator, reachability: Reachability, until: float) -> bool:
    """Waits for grasps in reach until a time [s], then puts the arm at the best of them, at rest.

    What the drive sends jumps along with it: the velocities and accelerations of such a run say
    nothing. The simulator is of the diagram of `make_dynamic_grasp`, initialized. It returns
    whether the run goes on: False if a monitor has ended it while it waited.
    """
    diagram, root = simulator.get_system(), simulator.get_mutable_context()
    station, drive, sequencer = map(diagram.GetSubsystemByName, ("station", "drive", "sequencer"))
    plant = station.plant
    arm = plant.GetModelInstanceByName(reachability.arm.name)
    plant_context = plant.GetMyMutableContextFromRoot(root)
    while root.get_time() < until:
        status = simulator.AdvanceTo(min(root.get_time() + 0.05, until))  # until the next look [s]
        if status.reason() != SimulatorStatus.ReturnReason.kReachedBoundaryTime:
            return False
        ports = sequencer.GetMyContextFromRoot(root)
        grasps = sequencer.GetOutputPort("grasps").Eval(ports)
        X_WO = sequencer.GetOutputPort("object_pose").Eval(ports).GetAsMatrix4()
        q, _ = reachability.nearest(X_WO @ grasps.X_OG, plant.GetPositions(plant_context, arm))
        found = np.flatnonzero(np.isfinite(q).all(axis=1))
        if len(found):
            best, rest = q[found[0]], np.zeros(reachability.arm.joints)
            sent = np.concatenate([best, rest])
            drive.GetMyMutableContextFromRoot(root).SetDiscreteState(0, sent)
            # The joints are where the arm's own controller takes them, by its encoders.
            sensors = station.GetSubsystemByName("joint_sensors")
            there = sensors.GetOutputPort("true_desired_state")
            state = there.Eval(sensors.GetMyContextFromRoot(root))
            plant.SetPositionsAndVelocities(plant_context, arm, state)
            return True
    return True
