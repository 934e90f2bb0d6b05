"""Status monitor: one record for console, replay and result file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.control.planning.search_pose import SearchTarget
from feasigrasp.models.control.status import Situation, Status, StatusCode, judge
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase, unmet_condition
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.reach.reachability import Verdict
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import tool_pose
from feasigrasp.models.shape.scene_field import SceneField
from feasigrasp.systems.point_cloud_to_gpdf import Perceived
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output, optional, scalar

#: Time between looks at the situation [s]. Source: guessed.
PERIOD = 0.1
#: So long it takes until it is said [s]: an arm that starts or turns round stands still, too, and
#: an object that moves comes back into reach. All else takes one look, since stages that follow
#: each other are one look late.
LASTS = {
    StatusCode.COMMAND_FAULTY: 0.0,
    StatusCode.TOUCHED: 0.0,
    StatusCode.BRAKING_FOR_OBSTACLE: 0.5,
    StatusCode.OUT_OF_REACH: 2.0,
    StatusCode.BLOCKED_BY_TABLE: 2.0,
}
#: Time between two entries of a hand that goes on following [s]: a few lines in a run of 30 s.
#: Source: reasoned.
AGAIN = 3.0
#: Verdicts that are no reason why nothing can be reached: of what is, or has not been judged.
_FINE = (Verdict.KEPT, Verdict.REACHABLE, Verdict.BETTER)


@dataclass(frozen=True, eq=False)
class _Reported(Frozen):
    """What was said until now.

    Attributes:
        history: Every status, oldest first.
        next: What is going on, and will be said if it lasts; None if it has been said.
        now: What is going on, with its present detail, since it was said.
        command_faults: Number of faulty commands.
        touches: Number of contacts of the arm.
        X_OH: Pose of the hand in the object, shape (4, 4), when that was let go, or now; None while
            the object's pose is not known.
        looks: What went on, each time that code or detail changed, oldest first.
        rejected: Times [s] and how many grasps were rejected then, by stage and reason.
    """

    history: tuple[Status, ...] = ()
    next: Status | None = None
    now: Status | None = None
    command_faults: int = 0
    touches: int = 0
    X_OH: Array | None = None
    looks: tuple[Status, ...] = ()
    rejected: tuple[tuple[float, Mapping[str, Mapping[str, int]]], ...] = ()

    def received(self, time: float, code: StatusCode, detail: str) -> _Reported:
        """With what is judged now; what passes at once is not said.

        Of a hand that follows it is said again every `AGAIN` seconds what keeps it from closing.
        """
        if self.history and code == self.history[-1].code:
            reported = self.history[-1].time
            if code is StatusCode.FOLLOWING and time - reported >= AGAIN - 1e-9:
                return self._with(Status(time, code, detail))
            return replace(self, next=None, now=Status(reported, code, detail))
        since = self.next.time if self.next is not None and self.next.code == code else time
        now = Status(since, code, detail)
        if time - since >= LASTS.get(code, PERIOD) - 1e-9:
            return self._with(now)
        return replace(self, next=now)

    def _with(self, now: Status) -> _Reported:
        return replace(self, history=(*self.history, now), next=None, now=now)

    def looked(self, time: float) -> _Reported:
        """With what goes on now, if it is another than at the last look or has another detail."""
        now, last = self.now, self.looks[-1] if self.looks else None
        if now is None or (last and (now.code, now.detail) == (last.code, last.detail)):
            return self
        return replace(self, looks=(*self.looks, Status(time, now.code, now.detail)))

    def counted(self, time: float, counts: Mapping[str, Mapping[str, int]]) -> _Reported:
        """With the rejections of now, if they are others, at most once a second."""
        known = self.rejected
        if known and (time < known[-1][0] + 1.0 - 1e-9 or known[-1][1] == counts):
            return self
        return replace(self, rejected=(*known, (time, counts)))


def _least_error(X_OG: Array, X_OH: Array | None) -> tuple[float, float]:
    """Distance [m] and angle [rad] of the hand to the nearest of poses (n, 4, 4); 0 if unknown."""
    if X_OH is None or len(X_OG) == 0:
        return 0.0, 0.0
    errors = grasp_errors(X_OG, X_OH)
    distance, angle = errors[int(errors[:, 0].argmin())]
    return float(distance), float(angle)


class StatusMonitor(LeafSystem):
    """Judges ten times a second what the arm is doing, or what keeps it from doing anything.

    .. pydrake_system::

        name: StatusMonitor
        input_ports: [position, desired_velocity, object_pose, tracking, perceived, grasps,
          verdicts, reachable, phase, command_faults, scene, touches, search_target, lapsed,
          contradicted]
        output_ports: [status, history]

    ``position`` and ``desired_velocity`` are V7; ``object_pose`` is the tracked one, ``tracking`` a
    `Tracking`; ``perceived`` a `Perceived`; ``grasps`` what the sampler found; ``verdicts`` what
    the reachability filter says of each; ``reachable`` what the controller is given; ``phase`` a
    `Phase`; ``command_faults`` the number of faulty commands until now; ``scene``, optional, a
    `SceneField` or None, says what was never seen; ``touches``, optional, how often the arm was
    touched; ``search_target``, optional, a `SearchTarget` while the arm looks for the object;
    ``lapsed``, optional, V1, not 0 while perception's process is gone; ``contradicted``, optional,
    is true while images are not of the camera's pose. ``status`` is the present `Status`,
    ``history`` a tuple of all of them, one for every change of the code, and one every `AGAIN`
    seconds of a hand that follows, with the condition for closing that it does not meet.
    """

    def __init__(
        self,
        gripper: Gripper,
        sequence: GraspSequenceConfig | None = None,
        *,
        sees_slip: bool = True,
        arm: Arm = IIWA_7,
    ) -> None:
        """A monitor of an arm that carries ``gripper``, which closes as ``sequence`` says.

        It ``sees_slip`` if the pose of an object in the hand is measured: a camera on the hand sees
        too little of it, and two of three slips that it shows are none.
        """
        super().__init__()
        self._sees_slip, self._arm = sees_slip, arm
        self._gripper, self._sequence = gripper, sequence or GraspSequenceConfig()
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        self._velocity = self.DeclareVectorInputPort("desired_velocity", arm.joints)
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._tracking = declare_input(self, "tracking", kind=Tracking | None)
        self._perceived = declare_input(self, "perceived", kind=Perceived | None)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._verdicts = declare_input(self, "verdicts", kind=tuple[str, ...])
        self._reachable = declare_input(self, "reachable", GraspSet.empty())
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._faults = self.DeclareVectorInputPort("command_faults", 1)
        self._scene = declare_input(self, "scene", kind=SceneField | None)
        self._balls = arm_balls(capsule_model(gripper, arm))
        self._touches = self.DeclareVectorInputPort("touches", 1)
        self._search_target = declare_input(self, "search_target", kind=SearchTarget | None)
        self._lapsed = self.DeclareVectorInputPort("lapsed", 1)
        self._contradicted = declare_input(self, "contradicted", kind=bool)
        self._reported = PeriodicState(self, _Reported(), PERIOD, self._look)
        declare_output(self, "status", self.status, {self._reported})
        declare_output(self, "history", self.history, {self._reported})

    def history(self, context: Context) -> tuple[Status, ...]:
        """Every status until now, oldest first."""
        return self._reported.Eval(context).history

    def looks(self, context: Context) -> tuple[Status, ...]:
        """Every status until now with all its details, for a replay: up to ten a second."""
        return self._reported.Eval(context).looks

    def rejected(self, context: Context) -> list[list[Any]]:
        """Until now, ``[time in s, {stage: {reason: rejected grasps}}]``, oldest first."""
        return [list(entry) for entry in self._reported.Eval(context).rejected]

    def status(self, context: Context) -> Status:
        """The present status."""
        return self._reported.Eval(context).now or Status(0.0, StatusCode.NOTHING_SEEN)

    def _look(self, context: Context) -> _Reported:
        reported: _Reported = self._reported.Eval(context)
        perceived = self._perceived.Eval(context)
        command_faults = int(self._faults.Eval(context)[0])
        touches = int(scalar(self._touches, context, 0.0))
        grasps: GraspSet = self._grasps.Eval(context)
        reachable: GraspSet = self._reachable.Eval(context)
        verdicts = Counter(map(str, self._verdicts.Eval(context)))
        # Those that are dropped before and after they are judged are only counted.
        for reason in (Rejection.HITS_SCENE, Rejection.UNOBSERVED, Rejection.TOO_HEAVY):
            verdicts[str(reason)] += reachable.rejected.get(reason, 0)
        judged = {reason: n for reason, n in verdicts.items() if reason not in _FINE}
        phase, X_OH = Phase(int(self._phase.Eval(context)[0])), self._hand(context)
        # A tracker that says nothing of its pose is taken to track.
        tracking = optional(self._tracking, context) or Tracking(TrackingState.TRACKING, 0.0)
        # The last look before the object was let go was at the very time.
        held = reported.X_OH if phase > Phase.CLOSE else X_OH
        in_hand = self._sees_slip and phase > Phase.CLOSE and not tracking.lost
        reference = held[None] if in_hand and held is not None else np.zeros((0, 4, 4))
        slipped, turned = _least_error(reference, X_OH)
        unmet = ""
        if X_OH is not None and len(reachable) > 0:
            measured = tracking.state is TrackingState.TRACKING
            unmet = unmet_condition(X_OH, reachable, self._sequence, measured=measured)
        code, detail = judge(
            Situation(
                phase=phase,
                tracking=tracking,
                search_target=optional(self._search_target, context) is not None,
                contradicted=perceived.contradicted,
                camera_contradicted=bool(optional(self._contradicted, context)),
                lapsed=scalar(self._lapsed, context, 0.0) > 0.0,
                seen=perceived.gpdf is not None,
                views_dropped=perceived.last_fault,
                grasps=len(grasps),
                rejected=grasps.rejected,
                reachable=len(reachable),
                verdicts=judged,
                command_faults=command_faults - reported.command_faults,
                touches=touches - reported.touches,
                speed=float(np.abs(self._velocity.Eval(context)).max()),
                left=_least_error(reachable.X_OG, X_OH)[0],
                unobserved=self._unobserved(context),
                slipped=slipped,
                turned=turned,
                unmet=unmet,
            )
        )
        time, held = context.get_time(), X_OH if held is None else held
        now = reported.received(time, code, detail).looked(time)
        dropped = {"sampler": grasps.rejected, "reachability": judged}
        counts = {stage: {k: n for k, n in of.items() if n} for stage, of in dropped.items()}
        now = replace(now, command_faults=command_faults, touches=touches, X_OH=held)
        return now.counted(time, counts)

    def _hand(self, context: Context) -> Array | None:
        """Pose of the hand in the object, shape (4, 4); None while that is nowhere."""
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        if not np.isfinite(X_WO).all():
            return None
        X_WH = tool_pose(self._position.Eval(context), self._gripper.X_FG, self._arm)
        return inverse_kernel(X_WO) @ X_WH

    def _unobserved(self, context: Context) -> float:
        """Distance of the arm to space that may belong to obstacles but was never seen [m]."""
        scene = optional(self._scene, context)
        if scene is None:
            return np.inf
        center = self._balls.placed(self._position.Eval(context))
        return float(np.min(scene.unobserved_distance(center) - self._balls.radius))
