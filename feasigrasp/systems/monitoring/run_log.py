"""Logs arm, object and grasp at the control rate."""

from collections.abc import Mapping
from math import prod

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.dynamic_grasp import Subsystems
from feasigrasp.systems.ports import add_connected, declare_input, declare_output, optional
from feasigrasp.systems.station.station import Station


def fields(joints: int) -> Mapping[str, tuple[int, ...]]:
    """The arrays of a log beside ``time``, and the shape of a sample.

    docs/results_schema.md defines them.
    """
    arm = dict.fromkeys(("q", "qd", "qd_commanded", "q_sent", "qd_sent"), (joints,))
    openings = dict.fromkeys(("opening", "opening_sent"), (1,))
    poses = dict.fromkeys(("X_WO", "X_WO_true"), (4, 4))
    return arm | openings | poses | {"phase": (1,), "X_OG": (4, 4)}


class RunLog(LeafSystem):
    """Puts what is logged of a run into one vector.

    .. pydrake_system::

        name: RunLog
        input_ports: [position, velocity, commanded_velocity, desired_state, gripper_state,
          gripper_position, object_pose, true_pose, phase, grasps, chosen_grasp]
        output_ports: [sample]

    ``position`` V7 [rad] and ``velocity`` V7 [rad/s] are the arm's; ``commanded_velocity`` is the
    controller's, ``desired_state`` the V14 of the drive; ``gripper_state`` V2 is the distance
    between the pads [m] and its rate, ``gripper_position`` V1 the commanded distance.
    ``object_pose`` is the tracked pose, ``true_pose`` the true one, which only a simulation has.
    ``phase`` is a `Phase`, ``grasps`` what the controller is given and ``chosen_grasp`` V16 the one
    that it goes for. ``true_pose`` and ``chosen_grasp`` are optional. ``sample`` holds `fields`.
    """

    def __init__(self, joints: int = IIWA_7.joints) -> None:
        super().__init__()
        n = joints
        self._arm = [
            self.DeclareVectorInputPort(name, size)
            for name, size in (
                *(("position", n), ("velocity", n), ("commanded_velocity", n)),
                *(("desired_state", 2 * n), ("gripper_state", 2), ("gripper_position", 1)),
            )
        ]
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._true_pose = declare_input(self, "true_pose", RigidTransform())
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._chosen = self.DeclareVectorInputPort("chosen_grasp", 16)
        size = sum(map(prod, fields(n).values()))
        declare_output(self, "sample", self._calc, size=size)

    def _calc(self, context: Context) -> NDArray[np.float64]:
        *arm, gripper, opening_sent = (port.Eval(context) for port in self._arm)
        poses = (_matrix(port, context) for port in (self._pose, self._true_pose))
        phase = self._phase.Eval(context)
        parts = [*arm, gripper[:1], opening_sent, *poses, phase, self._grasp(context, phase[0])]
        return np.concatenate([np.ravel(part) for part in parts])

    def _grasp(self, context: Context, phase: float) -> NDArray[np.float64]:
        """The grasp that the hand has committed to, or else goes for; NaN if there is none."""
        if phase > Phase.APPROACH:
            return self._grasps.Eval(context).X_OG[0]
        chosen: NDArray[np.float64] | None = optional(self._chosen, context)
        return np.full(16, np.nan) if chosen is None else chosen


def _matrix(port: InputPort, context: Context) -> NDArray[np.float64]:
    pose: RigidTransform | None = optional(port, context)
    return np.full((4, 4), np.nan) if pose is None else pose.GetAsMatrix4()


def add_run_log(builder: DiagramBuilder, subsystems: Subsystems, period: float = 0.005) -> None:
    """Adds the log of a run to a diagram: a ``connect`` of `make_dynamic_grasp`.

    The period [s] is by default that of the control in packaged scenarios.
    """
    station, tracker, sequencer = subsystems.station, subsystems.tracker, subsystems.sequencer
    position = station.GetOutputPort("arm.position_measured")
    inputs = {
        "position": position,
        "velocity": station.GetOutputPort("arm.velocity_estimated"),
        "commanded_velocity": subsystems.controller.GetOutputPort("commanded_velocity"),
        "desired_state": subsystems.drive.GetOutputPort("desired_state"),
        "gripper_state": station.GetOutputPort("gripper.state_measured"),
        "object_pose": tracker.GetOutputPort("object_pose"),
        **{name: sequencer.GetOutputPort(name) for name in ("gripper_position", "phase", "grasps")},
    }
    if subsystems.controller.HasOutputPort("chosen_grasp"):
        inputs["chosen_grasp"] = subsystems.controller.GetOutputPort("chosen_grasp")
    if builder.HasSubsystemNamed("true_frame"):
        inputs["true_pose"] = builder.GetSubsystemByName("true_frame").get_output_port()
    elif isinstance(station, Station):
        inputs["true_pose"] = station.GetOutputPort("object.pose")
    log = add_connected(builder, "run_log", RunLog(position.size()), **inputs)
    LogVectorOutput(log.get_output_port(), builder, period).set_name("log(run)")


def read_run_log(diagram: Diagram, context: Context) -> dict[str, NDArray[np.generic]]:
    """The log of `add_run_log` at the end of a run, by the diagram's context then.

    It has ``time`` (n,) [s], and `fields` with n samples each.
    """
    log = diagram.GetSubsystemByName("log(run)").FindLog(context)
    joints = diagram.GetSubsystemByName("run_log").GetInputPort("position").size()
    arrays: dict[str, NDArray[np.generic]] = {"time": log.sample_times().copy()}
    data, start = log.data().T, 0
    for name, shape in fields(joints).items():
        stop = start + prod(shape)
        arrays[name] = data[:, start:stop].reshape(-1, *(() if shape == (1,) else shape)).copy()
        start = stop
    return arrays | {"phase": arrays["phase"].astype(np.int8)}
