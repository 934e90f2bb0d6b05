"""The whole pipeline in time: how often each stage runs, and when the arm moves or stands still."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.models.clouds.checks import ViewFault
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.runs.metrics.reference_robot import reference_robot, self_collision_metrics
from feasigrasp.systems import (
    horizon_controller,
    point_cloud_to_gpdf,
    reachability_filter,
    velocity_drive,
)
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.station import object_servo
from tests.pipeline import scenario

DURATION = 1.0


def wrap(monkeypatch, calls, owner, name):
    """Counts the calls of a function, or method, under its name."""
    original = getattr(owner, name)

    def counting(*args, **kwargs):
        calls[name] = calls.get(name, 0) + 1
        return original(*args, **kwargs)

    monkeypatch.setattr(owner, name, counting)


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_every_stage_runs_at_its_own_rate(controller, monkeypatch):
    """Perception 2 Hz, adaptation 10 Hz, plans 50 Hz, control 200 Hz, plant 400 Hz."""
    calls: dict[str, int] = {}
    for owner, name in (
        (point_cloud_to_gpdf, "complete_shape"),
        (NetworkSampler, "__call__"),
        (reachability_filter, "feasible_grasps"),
        (horizon_controller, "next_plan"),
        (horizon_controller.HorizonController, "velocity"),
        (velocity_drive.VelocityDrive, "_update"),
        (object_servo, "motion_wrench_kernel"),
    ):
        wrap(monkeypatch, calls, owner, name)
    config = scenario(text=f"{{control: {{controller: {controller}}}, grasp: {{close: false}}}}")
    simulator = Simulator(make_dynamic_grasp(config))
    calls.clear()  # a controller runs one step when it is made, to compile its kernels
    simulator.AdvanceTo(DURATION)

    assert calls.pop("complete_shape") == 2
    assert calls.pop("__call__") == 2
    assert calls.pop("feasible_grasps") == 10
    assert calls.pop("_update") == 200
    # Once more when the state of a slow stage changes between the log of the torque and the step.
    assert 400 <= calls.pop("motion_wrench_kernel") <= 410
    assert calls.pop("next_plan") == 50
    assert calls.pop("velocity") == 200
    assert calls == {}


def arm_positions(config, duration):
    """True arm positions and commands at 50 Hz, and the diagram with its context at the end."""
    diagram = make_dynamic_grasp(config)
    simulator = Simulator(diagram)
    controller, station = (diagram.GetSubsystemByName(n) for n in ("controller", "station"))
    q, command = [], []
    for k in range(round(duration / 0.02) + 1):
        simulator.AdvanceTo(0.02 * k)
        root = simulator.get_context()
        q.append(
            station.GetOutputPort("arm.state_estimated")
            .Eval(station.GetMyContextFromRoot(root))[:7]
            .copy()
        )
        command.append(
            controller.GetOutputPort("commanded_velocity")
            .Eval(controller.GetMyContextFromRoot(root))
            .copy()
        )
    return np.array(q), np.array(command), diagram, simulator.get_context()


@pytest.mark.parametrize("controller", ["task", "joint"])
@pytest.mark.parametrize(
    ("center", "reason"),
    [([-1.5, 0.0, 0.5], "object not seen"), ([1.15, 0.0, 0.75], "wrist out of reach")],
    ids=["not seen", "out of reach"],
)
def test_an_object_that_cannot_be_grasped_leaves_the_arm_where_it_is(controller, center, reason):
    config = scenario(
        text=f"{{motion: {{center: {center}, amplitude: [0, 0, 0]}},"
        f" control: {{controller: {controller}}}}}"
    )
    if reason == "wrist out of reach":  # look ahead, to where the object is
        config.q_start = [0.0, -30.0, 0.0, -90.0, 0.0, 25.0, 0.0]
    q, command, diagram, context = arm_positions(config, 0.3)
    np.testing.assert_array_equal(command, 0.0)
    np.testing.assert_allclose(q, np.tile(config.start, (len(q), 1)), atol=1e-4)
    reachable = diagram.GetSubsystemByName("reachable")
    grasps = reachable.get_output_port().Eval(reachable.GetMyContextFromRoot(context))
    assert len(grasps) == 0
    assert grasps.rejected[reason] > 0


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_the_arm_sets_off_for_a_grasp_once_it_has_one(controller):
    config = scenario(text=f"{{control: {{controller: {controller}}}}}")
    q, command, diagram, context = arm_positions(config, 0.6)
    # Nothing before the latency of perception has passed.
    before = np.arange(len(q)) * 0.02 < config.perception.latency - 1e-9
    np.testing.assert_array_equal(command[before], 0.0)
    assert np.linalg.norm(command[-1]) > 0.02
    assert np.isfinite(command).all()
    assert np.all(np.abs(q) < IIWA_7.upper)
    logger = diagram.GetSubsystemByName("log(metrics)")
    samples = dict(zip(SAMPLE_NAMES, logger.FindLog(context).data(), strict=True))
    error = samples["grasp_position_error"][np.isfinite(samples["grasp_position_error"])]
    assert error[-1] < error[0]
    assert (
        self_collision_metrics(reference_robot(config.directives), q)["self_collision_percent"]
        == 0.0
    )


def test_latency_delays_the_grasps(monkeypatch):
    slow = scenario(text="{perception: {latency: 0.3}}")
    _, command, _, _ = arm_positions(slow, 0.5)
    moving = np.flatnonzero(np.any(command, axis=1)) * 0.02
    assert 0.3 - 1e-9 <= moving[0] <= 0.3 + slow.reachability.period + 0.02


def test_the_time_of_a_view_arrives_with_its_grasps():
    built = make_dynamic_grasp(scenario(text="{perception: {latency: 0.23}}"))
    grasps, view_time = (built.GetSubsystemByName(n) for n in ("latency", "view_time(latency)"))
    simulator, pairs = Simulator(built), []
    for t in np.arange(0.0, 1.5, 0.01):
        simulator.AdvanceTo(t)
        root = simulator.get_context()
        there = grasps.get_output_port().Eval(grasps.GetMyContextFromRoot(root))
        time = view_time.get_output_port().Eval(view_time.GetMyContextFromRoot(root))[0]
        if len(there) > 0:
            pairs.append((there, time, t))
    sets, times = {id(there) for there, _, _ in pairs}, {time for _, time, _ in pairs}
    assert times == {0.0, 0.5, 1.0}
    assert len(sets) == len({(id(there), time) for there, time, _ in pairs}) == 3
    assert all(0.225 < t - time < 0.735 for _, time, t in pairs)


def test_an_object_that_was_never_measured_moves_nothing():
    """No truth leaks: nothing is perceived, the arm stays where it is, and every view is named."""
    config = scenario("ReachObstacleMocap", "{tracker: {dropout: 1.0}}")
    diagram = make_dynamic_grasp(config)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.6)
    context = simulator.get_context()
    perception, log = (diagram.GetSubsystemByName(name) for name in ("perception", "log(drive)"))
    seen = perception.GetOutputPort("perceived").Eval(perception.GetMyContextFromRoot(context))
    assert seen.gpdf is None
    assert seen.faults == {ViewFault.UNKNOWN_POSE: 2}  # at 0 and at 0.5 s
    q = log.FindLog(context).data()[
        :7
    ]  # what is sent: the object that nobody sees may push the arm
    np.testing.assert_array_equal(q, np.broadcast_to(q[:, :1], q.shape))
