"""The monitor says what lasts, once, and when it began."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.control.status import StatusCode
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.tracking import Tracking
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.monitoring.status_monitor import AGAIN, StatusMonitor
from feasigrasp.systems.point_cloud_to_gpdf import Perceived

GPDF = fit_gpdf(sphere_points(64, 0.03))
NOTHING = Perceived(FusedCloud.empty(0.003), None)
SEEN = Perceived(FusedCloud.empty(0.003), GPDF)
GRASPS = GraspSet(np.eye(4)[None], np.array([0.04]), np.array([1.0]))


class Monitored:
    """A monitor whose inputs are set by hand."""

    def __init__(self, *, sees_slip=True):
        self.dut = StatusMonitor(ParallelGripper(), sees_slip=sees_slip)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()
        self.fix(
            position=np.full(7, 0.5),
            desired_velocity=np.full(7, 0.5),
            object_pose=RigidTransform([0.5, 0.0, 0.5]),
            tracking=Value[object](Tracking.of_age(0.0, 0.5)),
            perceived=Value[object](SEEN),
            grasps=GRASPS,
            verdicts=Value[object](("kept",)),
            reachable=GRASPS,
            phase=[Phase.APPROACH],
            command_faults=[0.0],
        )

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def reported(self, t):
        """Codes and times of all that has been said by time t."""
        self.simulator.AdvanceTo(t)
        history = self.dut.GetOutputPort("history").Eval(self.context)
        return [(status.code, pytest.approx(status.time)) for status in history]


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    dut = StatusMonitor(ParallelGripper())
    inputs, outputs = ports(dut)
    assert (list(inputs), list(outputs)) == documented_ports(StatusMonitor)


def test_a_change_is_said_once_with_its_beginning():
    monitored = Monitored()
    monitored.fix(perceived=Value[object](NOTHING))
    assert monitored.reported(0.35) == [(StatusCode.NOTHING_SEEN, 0.0)]
    monitored.fix(perceived=Value[object](SEEN))
    expected = [(StatusCode.NOTHING_SEEN, 0.0), (StatusCode.FOLLOWING, 0.4)]
    assert monitored.reported(1.05) == expected
    monitored.fix(tracking=Value[object](Tracking.of_age(0.7, 0.5)))
    assert monitored.reported(1.95) == [*expected, (StatusCode.POSE_LOST, 1.1)]
    status = monitored.dut.GetOutputPort("status").Eval(monitored.context)
    assert status.code is StatusCode.POSE_LOST
    assert "0.7 s" in status.detail


def test_what_passes_at_once_is_not_said():
    monitored = Monitored()
    monitored.reported(0.55)
    monitored.fix(reachable=GraspSet.empty(), verdicts=Value[object](("table", "table")))
    monitored.reported(0.65)
    monitored.fix(reachable=GRASPS)
    assert [code for code, _ in monitored.reported(2.0)] == [StatusCode.FOLLOWING]


def test_an_arm_that_stands_before_its_grasp_is_said_to_be_held_up():
    monitored = Monitored()
    monitored.reported(0.25)
    monitored.fix(desired_velocity=np.zeros(7))
    assert [code for code, _ in monitored.reported(0.75)] == [StatusCode.FOLLOWING]
    assert monitored.reported(1.0)[-1] == (StatusCode.BRAKING_FOR_OBSTACLE, 0.3)


def test_faulty_commands_are_said_at_once_and_while_they_come():
    monitored = Monitored()
    monitored.reported(0.25)
    monitored.fix(command_faults=[3.0])
    assert monitored.reported(0.35)[-1] == (StatusCode.COMMAND_FAULTY, 0.3)
    assert monitored.reported(0.75)[-1] == (StatusCode.FOLLOWING, 0.4)


def test_the_most_frequent_reason_is_told():
    monitored = Monitored()
    better = 3 * ("better grasps in reach",)  # no reason, where the scene takes them all
    reasons = ("joint limits", "table", "table", "kept", *better)
    monitored.fix(reachable=GraspSet.empty(), verdicts=Value[object](reasons))
    monitored.reported(0.5)
    status = monitored.dut.GetOutputPort("status").Eval(monitored.context)
    assert (status.code, status.detail) == (StatusCode.WAITING, "table")


def test_an_object_out_of_reach_is_a_fault_only_if_it_stays_there():
    monitored = Monitored()
    away = Value[object](3 * ("wrist out of reach",))
    monitored.fix(reachable=GraspSet.empty(), verdicts=away)
    monitored.reported(1.75)
    monitored.fix(reachable=GRASPS)
    assert {code for code, _ in monitored.reported(2.05)} == {StatusCode.FOLLOWING}
    monitored.fix(reachable=GraspSet.empty(), verdicts=away)
    assert monitored.reported(4.5)[-1] == (StatusCode.OUT_OF_REACH, 2.1)


def test_rejected_grasps_are_counted_by_stage_when_the_counts_change():
    monitored = Monitored()
    monitored.fix(verdicts=Value[object](("joint limits", "table", "table", "kept")))
    monitored.reported(0.55)
    few = {"joint limits": 1, "table": 2}
    assert monitored.dut.rejected(monitored.context) == [[0.0, counts(few)]]
    monitored.fix(grasps=GraspSet.empty({"too wide": 5, "none of these": 0}))
    monitored.reported(0.95)  # once a second
    assert len(monitored.dut.rejected(monitored.context)) == 1
    monitored.reported(3.05)
    (_, found), (time, last) = monitored.dut.rejected(monitored.context)
    assert found == counts(few) and last == counts(few, {"too wide": 5})
    assert time == pytest.approx(1.0)


def counts(reachability, sampler=None):
    return {"sampler": sampler or {}, "reachability": reachability}


@pytest.mark.parametrize("sees_slip", [True, False])
def test_an_object_that_turns_in_the_hand_slips(sees_slip):
    """The hand stays; the object in it turns by 15 degrees, and a lost pose says nothing.

    Nor does that of a camera, which sees too little of an object in the hand.
    """
    monitored = Monitored(sees_slip=sees_slip)
    X_WO = RigidTransform([0.5, 0.0, 0.5])
    X_WH = RigidTransform(forward_kinematics(np.full(7, 0.5), ParallelGripper().X_FG))
    # That the hand is not quite at the grasp that it went for is no slip.
    beside = X_WO.inverse() @ X_WH @ RigidTransform([0.008, 0.0, 0.008])
    grasp = GraspSet(beside.GetAsMatrix4()[None], [0.04], [1.0])
    monitored.fix(phase=[Phase.CLOSE], reachable=grasp, object_pose=X_WO)
    monitored.reported(0.5)
    monitored.fix(phase=[Phase.LIFT])
    assert monitored.reported(1.0)[-1][0] is StatusCode.LIFTING
    about_hand = X_WH @ RigidTransform(RollPitchYaw(np.deg2rad(15.0), 0.0, 0.0), [0.0, 0.0, 0.0])
    monitored.fix(object_pose=about_hand @ X_WH.inverse() @ X_WO)
    said = StatusCode.SLIPPING if sees_slip else StatusCode.LIFTING
    assert monitored.reported(2.0)[-1][0] is said
    monitored.fix(tracking=Value[object](Tracking.of_age(2.0, 0.5)))
    assert monitored.reported(3.0)[-1][0] is StatusCode.LIFTING


def test_a_touch_is_said_at_once_and_not_for_longer_than_it_lasts():
    monitored = Monitored()
    monitored.fix(touches=[0.0])
    assert monitored.reported(0.35) == [(StatusCode.FOLLOWING, 0.0)]
    monitored.fix(touches=[2.0])
    monitored.reported(0.45)
    after = [(StatusCode.FOLLOWING, 0.0), (StatusCode.TOUCHED, 0.4), (StatusCode.FOLLOWING, 0.5)]
    assert monitored.reported(1.0) == after


def test_of_a_hand_that_follows_it_is_said_again_and_again_what_keeps_it_from_closing():
    monitored = Monitored()
    hand = forward_kinematics(np.full(7, 0.5), ParallelGripper().X_FG)
    monitored.fix(object_pose=RigidTransform(hand))
    monitored.reported(0.5)
    status = monitored.dut.GetOutputPort("status")
    assert "at a grasp" in status.Eval(monitored.context).detail
    hand[:3, 3] += 0.05 * hand[:3, 2]
    monitored.fix(object_pose=RigidTransform(hand))
    monitored.reported(0.8)
    now = status.Eval(monitored.context)  # at once, while the history keeps what was said
    assert "50 mm off the nearest grasp (closes at 6)" in now.detail
    assert monitored.reported(2 * AGAIN + 0.5) == [
        (StatusCode.FOLLOWING, t) for t in (0.0, pytest.approx(AGAIN), pytest.approx(2 * AGAIN))
    ]
    history = monitored.dut.GetOutputPort("history").Eval(monitored.context)
    assert "at a grasp" in history[0].detail and "50 mm" in history[-1].detail


def test_a_replay_shows_each_change_of_a_detail_when_it_came():
    monitored = Monitored()
    poses = RigidTransform(forward_kinematics(np.full(7, 0.5), ParallelGripper().X_FG))
    for step in range(3):
        away = RigidTransform([0.0, 0.0, 0.1 * (3 - step)])
        monitored.fix(object_pose=poses @ away)
        monitored.reported(0.5 * step + 0.45)
    looks = monitored.dut.looks(monitored.context)
    assert [look.time for look in looks] == pytest.approx([0.1, 0.5, 1.0])
    for look, distance in zip(looks, (300, 200, 100), strict=True):
        assert f"{distance} mm off the nearest grasp" in look.detail
    assert len(monitored.reported(1.45)) == 1  # the record has one line of it
