"""Cell, guard and controller in one process, in lock-step over a bus inside it."""

import copy
import itertools

import numpy as np
import pytest
from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_image, lcmt_image_array
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.control_loop import ControlLoop
from feasigrasp.systems.hardware.guard import Guard
from feasigrasp.systems.hardware.simulated_cell import make_simulated_cell
from feasigrasp.systems.hardware.station import HardwareStation
from feasigrasp.systems.monitoring.run_log import add_run_log, read_run_log

#: Ports of a simulated cell that say what no sensor would.
TRUTH = {"object.velocity", "contact_results", "query_object", "object.hold"}


@pytest.fixture(scope="module")
def wire():
    """What was sent on every channel in the first 1.5 s; cell; control; errors of the pose [m];
    what is known of the camera at every step.
    """
    inline = "{perception: {execution: inline}}"  # in lock-step, whatever takes how long
    scenario = load_scenario(
        diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None, inline
    )
    lcm, sent, time = DrakeLcm("memq://"), {}, 0.0
    simulator = Simulator(make_simulated_cell(scenario, lcm))
    loop, guard = ControlLoop(scenario, lcm, add_run_log), Guard(lcm, clock=lambda: time)
    station = simulator.get_system().GetSubsystemByName("station")
    listening = lcm.SubscribeAllChannels(
        lambda channel, data: sent.setdefault(channel, []).append((time, data))
    )
    errors, cameras = [], []
    tracker = loop.diagram.GetSubsystemByName("tracker")
    simulator.Initialize()
    for k in range(1, 301):
        time = k * channels.IIWA_PERIOD
        simulator.AdvanceTo(time)
        loop.step(0.0)
        if loop.started:
            found = pose(tracker, "object_pose", loop.simulator)
            errors.append(np.linalg.norm(found - pose(station, "object.pose", simulator)))
            cameras.append(camera(loop))
    del listening, guard
    return sent, simulator, loop, errors, cameras


def camera(loop):
    """Pose of the camera and joints as the controller has them; its pose at its last image."""
    root = loop.simulator.get_context()
    station, controller = (loop.diagram.GetSubsystemByName(n) for n in ("station", "controller"))
    context = controller.GetMyContextFromRoot(root)
    now, q = (controller.GetInputPort(n).Eval(context) for n in ("camera_pose", "position"))
    then = station.GetOutputPort("wrist_camera.pose").Eval(station.GetMyContextFromRoot(root))
    return copy.deepcopy((now, q, then))  # ports hand out what will change


def pose(system, port, simulator):
    """Where a port says that the object is."""
    context = system.GetMyContextFromRoot(simulator.get_context())
    return system.GetOutputPort(port).Eval(context).translation()


def test_the_object_is_where_it_is_from_the_beginning(wire):
    """The controller's clock begins later than that of the messages."""
    assert len(wire[3]) > 200 and max(wire[3]) < 2e-3


def commands(wire, channel):
    found = [(t, lcmt_iiwa_command.decode(data)) for t, data in wire[0][channel]]
    return np.array([t for t, _ in found]), np.array([m.joint_position for _, m in found])


def test_only_what_drivers_and_sensors_say_goes_over_the_wire(wire):
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None)
    to_the_drivers = {channels.IIWA_REQUEST, channels.IIWA_COMMAND, channels.WSG_COMMAND}
    assert set(wire[0]) == {*channels.inbound(scenario), *to_the_drivers}
    assert set(channels.inbound(scenario)) == {
        *("IIWA_STATUS", "SCHUNK_WSG_STATUS", "FEASIGRASP_OBJECT_POSE"),
        "DRAKE_RGBD_CAMERA_IMAGES_wrist_camera",
    }


def test_where_depth_tells_the_object_no_mask_is_sent():
    text = "{perception: {segmentation: depth}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
    lcm, images = DrakeLcm("memq://"), []
    simulator = Simulator(make_simulated_cell(scenario, lcm))
    channel = channels.image_channel("wrist_camera")
    lcm.Subscribe(channel, lambda data: images.extend(lcmt_image_array.decode(data).images))
    simulator.AdvanceTo(0.11)
    lcm.HandleSubscriptions(0)
    assert images
    assert {image.pixel_format for image in images} == {lcmt_image.PIXEL_FORMAT_DEPTH}


def test_the_station_has_no_ports_of_truth(wire):
    station = wire[2].diagram.GetSubsystemByName("station")
    ports = [station.get_output_port(i).get_name() for i in range(station.num_output_ports())]
    ports += [station.get_input_port(i).get_name() for i in range(station.num_input_ports())]
    assert not TRUTH & set(ports)
    assert not any(wire[2].diagram.HasSubsystemNamed(name) for name in ("metrics", "contact"))


def test_the_same_ports_as_a_simulated_station(wire, documented_ports):
    simulated = wire[1].get_system().GetSubsystemByName("station")
    station = wire[2].diagram.GetSubsystemByName("station")
    names = {station.get_output_port(i).get_name() for i in range(station.num_output_ports())}
    at_image = {"object.stamp", "wrist_camera.stamp", "wrist_camera.position"}
    at_image |= {"wrist_camera.pose_now", "wrist_camera.gripper_state"}
    assert all(simulated.HasOutputPort(name) for name in names - at_image)
    assert names == {
        name.replace("<camera>", "wrist_camera") for name in documented_ports(type(station))[1]
    }


def test_the_log_has_what_drivers_say_and_no_truth(wire):
    log = read_run_log(wire[2].diagram, wire[2].simulator.get_context())
    assert np.isnan(log["X_WO_true"]).all() and np.isfinite(log["X_WO"][-1]).all()
    requested = commands(wire, channels.IIWA_REQUEST)[1]
    off = np.abs(requested - log["q_sent"][1:, None]).max(axis=2).min(axis=1)
    assert len(off) > 200 and off.max() < 1e-12
    # The velocities are the driver's estimates: positions differ by what they say. Encoders round.
    n = 20
    moved = (log["q"][n:] - log["q"][:-n]) / (n * channels.IIWA_PERIOD)
    said = np.cumsum(0.5 * (log["qd"][1:] + log["qd"][:-1]), axis=0) / n
    np.testing.assert_allclose(said[n:] - said[:-n], moved[1:], atol=0.02)
    assert np.abs(log["qd"]).max() > 0.1


def test_rates_are_those_of_the_drivers(wire):
    counts = {channel: len(messages) for channel, messages in wire[0].items()}
    assert counts[channels.IIWA_STATUS] == pytest.approx(300, abs=2)
    assert counts[channels.WSG_STATUS] == pytest.approx(30, abs=2)
    assert counts[channels.image_channel("wrist_camera")] == pytest.approx(15, abs=2)
    assert counts[channels.IIWA_COMMAND] == pytest.approx(240, abs=3)


def test_no_command_before_the_driver_takes_one(wire):
    times, _ = commands(wire, channels.IIWA_COMMAND)
    assert times[0] > 0.25


def test_it_starts_where_the_arm_is_and_keeps_the_limits(wire):
    times, Q = commands(wire, channels.IIWA_COMMAND)
    status = [lcmt_iiwa_status.decode(data) for t, data in wire[0][channels.IIWA_STATUS]
              if t <= times[0]]  # fmt: skip
    q_start = np.array(status[-1].joint_position_measured)
    np.testing.assert_allclose(q_start, np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0]), atol=1e-3)
    np.testing.assert_allclose(Q[0], q_start, atol=1e-6)
    v = np.diff(np.vstack([q_start, Q]), axis=0) / channels.IIWA_PERIOD
    a = np.diff(np.vstack([np.zeros(7), v]), axis=0) / channels.IIWA_PERIOD
    assert (np.abs(v) <= IIWA_7.velocity_limits).all()
    assert (np.abs(a[1:]) <= IIWA_7.acceleration_limits * (1 + 1e-6)).all()
    assert np.abs(v).max() > 0.1  # it does move


def test_an_arm_of_six_joints_moves_within_its_limits():
    """As with ``--arm ur5e`` in both commands."""
    text = "{arm: ur5e, perception: {execution: inline}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
    arm, lcm, time, sent = load_arm("ur5e"), DrakeLcm("memq://"), 0.0, []
    simulator = Simulator(make_simulated_cell(scenario, lcm))
    loop = ControlLoop(scenario, lcm)
    guard = Guard(lcm, CommandGuard(channels.IIWA_PERIOD, arm=arm), clock=lambda: time)
    lcm.Subscribe(channels.IIWA_COMMAND, lambda data: sent.append(lcmt_iiwa_command.decode(data)))
    for k in range(1, 181):
        time = k * channels.IIWA_PERIOD
        simulator.AdvanceTo(time)
        loop.step(0.0)
    Q = np.array([message.joint_position for message in sent])
    assert len(Q) > 100 and Q.shape[1] == 6 and guard.dropped.total() == 0
    np.testing.assert_allclose(Q[0], arm.home, atol=1e-3)
    v = np.diff(Q, axis=0) / channels.IIWA_PERIOD
    a = np.diff(v, axis=0) / channels.IIWA_PERIOD
    assert (np.abs(v) <= arm.velocity_limits).all() and np.abs(v).max() > 0.1
    assert (np.abs(a) <= arm.acceleration_limits * (1 + 1e-6)).all()


def test_the_arm_does_what_is_asked_for(wire):
    """The guard neither lags nor leads by more than two periods."""
    asked, Q_asked = commands(wire, channels.IIWA_REQUEST)
    sent, Q_sent = commands(wire, channels.IIWA_COMMAND)
    both, i, j = np.intersect1d(np.round(asked, 4), np.round(sent, 4), return_indices=True)
    assert len(both) > 200
    off, speed = np.abs(Q_asked[i] - Q_sent[j]), np.abs(np.gradient(Q_sent[j], axis=0))
    assert (off <= 2.0 * speed + 0.002)[-100:].all()  # two periods at that speed
    assert off[-100:].max() < 0.015
    simulator = wire[1]
    log = simulator.get_system().GetSubsystemByName("log(arm)").FindLog(simulator.get_context())
    behind = np.abs(log.data()[:7, -1] - Q_sent[-1])
    assert (behind <= 0.04 * IIWA_7.velocity_limits).all()  # 40 ms at its fastest


def test_what_the_camera_saw_is_where_the_object_is(wire):
    """The field in O, seen by an arm that moves, of an object that moves: millimetres, all told."""
    loop = wire[2]
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None)
    vertices = np.asarray(load_scenario_object(scenario).mesh.vertices)
    perception = loop.diagram.GetSubsystemByName("perception")
    context = perception.GetMyContextFromRoot(loop.simulator.get_context())
    cloud = perception.GetOutputPort("perceived").Eval(context).cloud
    assert len(cloud.points) > 50
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    outside = np.maximum(low - cloud.points, cloud.points - high).max(axis=1)
    assert np.percentile(outside, 95) < 0.01


def test_control_has_the_camera_where_it_is_on_the_hand(wire):
    """An arm that moves is elsewhere when its image arrives: joints and camera are of one time."""
    plant = wire[2].diagram.GetSubsystemByName("station").plant
    arm, context = plant.GetModelInstanceByName("iiwa"), plant.CreateDefaultContext()

    def on_flange(X_WC, q):
        plant.SetPositions(context, arm, q)
        X_WF = plant.GetFrameByName("iiwa_flange").CalcPoseInWorld(context)
        return (X_WF.inverse() @ X_WC).translation()

    expected = on_flange(mount("{}")[0], np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0]))
    found = [on_flange(X_WC, q) for X_WC, q, _ in wire[4]]
    np.testing.assert_allclose(found, np.tile(expected, (len(found), 1)), atol=1e-4)
    at_image = [on_flange(X_WC, q) for _, q, X_WC in wire[4]]
    assert np.linalg.norm(at_image - expected, axis=1).max() > 5e-3  # that would be wrong


def mount(text):
    """Pose of the camera on the camera's stand, in the simulated cell and as believed."""
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None, text)
    cell = make_simulated_cell(scenario, DrakeLcm("memq://"))
    station = cell.GetSubsystemByName("station")
    sensor = station.GetSubsystemByName("rgbd_sensor_wrist_camera")
    context = sensor.GetMyContextFromRoot(cell.CreateDefaultContext())
    X_WC = sensor.body_pose_in_world_output_port().Eval(context)
    bus = DrakeLcm("memq://")
    behind = HardwareStation(scenario, bus, bus).GetSubsystemByName("wrist_camera_pose")
    context = behind.CreateDefaultContext()
    behind.get_input_port().FixValue(context, scenario.start)
    return X_WC, behind.get_output_port().Eval(context)


def test_the_camera_stands_off_where_it_is_believed_by_the_error_of_its_calibration():
    noise = "{camera_noise: {wrist_camera: {%s}}}"
    right, believed = mount(noise % "")
    assert right.IsNearlyEqualTo(believed, 1e-6)
    wrong, believed_wrongly = mount(noise % "hand_eye_position: 0.005, hand_eye_angle_deg: 1.0")
    assert believed_wrongly.IsExactlyEqualTo(believed)
    error = wrong.inverse() @ believed
    assert np.linalg.norm(error.translation()) == pytest.approx(0.005, abs=1e-5)
    assert error.rotation().ToAngleAxis().angle() == pytest.approx(np.deg2rad(1.0), abs=1e-5)


def test_the_guard_outlives_messages_that_are_cut_off():
    """It has to outlive the controller: without it the driver keeps the last command for ever."""
    lcm = DrakeLcm("memq://")
    ticks = itertools.count()
    guard, answers = Guard(lcm, clock=lambda: next(ticks) * channels.IIWA_PERIOD), []
    listening = lcm.Subscribe(channels.IIWA_COMMAND, answers.append)
    lcm.Publish(channels.IIWA_STATUS, an_iiwa_status(0)[:40])
    request = lcmt_iiwa_command()
    request.num_joints, request.joint_position = 7, [0.0] * 7
    lcm.Publish(channels.IIWA_REQUEST, request.encode()[:30])
    for utime in range(5000, 1_000_000, 5000):
        lcm.Publish(channels.IIWA_STATUS, an_iiwa_status(utime))
    while lcm.HandleSubscriptions(0):
        pass
    assert answers
    del listening, guard


def an_iiwa_status(utime):
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = utime, 7
    for name in message.__slots__[2:]:
        setattr(message, name, [0.0] * 7)
    return message.encode()
