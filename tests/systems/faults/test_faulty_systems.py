"""Systems with a fault pass on what comes before it and after it, and its own in between."""

import copy

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.fault import (
    CommandNan,
    CommandWild,
    PerceptionLate,
    PoseFrozen,
    PoseJump,
    PoseLate,
    PoseNan,
)
from feasigrasp.models.faults.images import (
    CameraFrozen,
    CameraGone,
    CameraMirrored,
    MaskShifted,
    OnePlane,
    Outliers,
)
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.stages.faults import (
    FaultInjection,
    FaultyDepth,
    FaultyPose,
    LateField,
    faulty_cloud,
    faulty_command,
    faulty_mask,
)

FILE = diagram_path("dynamic.scenarios.yaml")
LABEL = 5
WINDOW = {"start": 1.0, "duration": 1.0}


@pytest.mark.parametrize(
    "dut",
    [FaultyPose(PoseNan(), 0.01), LateField(PerceptionLate()), FaultyDepth(CameraFrozen(), 0.1)],
    ids=lambda d: type(d).__name__,
)
def test_ports_are_those_of_the_docstring(dut, ports, documented_ports):
    inputs, outputs = ports(dut)
    assert (list(inputs), list(outputs)) == documented_ports(type(dut))


# ---------------------------------------------------------------------------------------- images


def labels():
    image = ImageLabel16I(12, 8)
    image.mutable_data[:] = 2
    image.mutable_data[2:6, 3:7] = LABEL
    return image


def cloud():
    points = PointCloud(96)
    points.mutable_xyzs()[:] = np.random.default_rng(0).uniform(0.3, 0.9, (3, 96))
    return points


def images(fixed_context, dut, t):
    inputs = {"point_cloud": cloud(), "label_image": labels(), "camera_pose": RigidTransform()}
    names = [dut.get_input_port(i).get_name() for i in range(dut.num_input_ports())]
    context = fixed_context(dut, **{name: inputs[name] for name in names})
    context.SetTime(t)
    return dut.get_output_port().Eval(context)


@pytest.mark.parametrize("fault", [CameraGone(**WINDOW), OnePlane(**WINDOW), Outliers(**WINDOW)])
def test_a_cloud_is_untouched_before_and_after(fixed_context, fault):
    dut, before = faulty_cloud(fault, LABEL), cloud().xyzs()
    for t in (0.0, 0.99, 2.0, 9.0):
        np.testing.assert_array_equal(images(fixed_context, dut, t).xyzs(), before)
    assert not np.array_equal(images(fixed_context, dut, 1.0).xyzs(), before)


def test_the_pixels_of_the_object_are_those_of_its_label(fixed_context):
    """One plane: the object's depths, along the camera's z, are one; others are as before."""
    seen = images(fixed_context, faulty_cloud(OnePlane(), LABEL), 0.0).xyzs()
    on = labels().data.reshape(-1) == LABEL
    assert np.ptp(seen[2, on]) < 1e-6 < np.ptp(cloud().xyzs()[2, on])
    np.testing.assert_array_equal(seen[:, ~on], cloud().xyzs()[:, ~on])


def test_outliers_repeat_with_the_seed_and_differ_from_view_to_view(fixed_context):
    fault = Outliers(share=0.3)
    first = images(fixed_context, faulty_cloud(fault, LABEL, 1), 0.5).xyzs()
    np.testing.assert_array_equal(
        first, images(fixed_context, faulty_cloud(fault, LABEL, 1), 0.5).xyzs()
    )
    for seed, t in ((2, 0.5), (1, 1.0)):
        other = images(fixed_context, faulty_cloud(fault, LABEL, seed), t).xyzs()
        assert not np.array_equal(first, other)


def test_a_shifted_mask_uncovers_the_world_and_covers_what_is_beside(fixed_context):
    dut = faulty_mask(MaskShifted(columns=2, rows=1, **WINDOW), LABEL)
    for t in (0.0, 2.0):
        np.testing.assert_array_equal(images(fixed_context, dut, t).data, labels().data)
    expected = np.full((8, 12), 2)
    expected[2:6, 3:7] = 0
    expected[3:7, 5:9] = LABEL
    np.testing.assert_array_equal(images(fixed_context, dut, 1.5).data[:, :, 0], expected)


# ----------------------------------------------------------------------------------------- poses


def turning(t):
    return RigidTransform(RotationMatrix.MakeZRotation(0.3 * t), [0.1 * t, 0.0, 0.5])


class Source(LeafSystem):
    """An abstract output of the time."""

    def __init__(self, of_time, kind=object):
        super().__init__()
        self.DeclareAbstractOutputPort(
            "out", Value[kind], lambda context, value: value.set_value(of_time(context.get_time()))
        )


class Recorder(LeafSystem):
    """What comes in, by tick."""

    def __init__(self, period, kind=object):
        super().__init__()
        self.found = {}
        port = self.DeclareAbstractInputPort("in", Value[kind]())
        self.DeclarePeriodicPublishEvent(
            period,
            0.0,
            lambda context: self.found.__setitem__(
                round(context.get_time() / period), copy.deepcopy(port.Eval(context))
            ),
        )


def passed_on(dut, of_time, until, period=0.01, kind=object):
    builder = DiagramBuilder()
    source, recorder = Source(of_time, kind), Recorder(period, kind)
    for system in (source, dut, recorder):
        builder.AddSystem(system)
    builder.Connect(source.get_output_port(), dut.get_input_port())
    builder.Connect(dut.get_output_port(), recorder.get_input_port())
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(until)
    return recorder.found


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (PoseNan(start=0.1, duration=0.1), lambda t: None),
        (PoseFrozen(start=0.1, duration=0.1), lambda t: turning(0.09)),
        (
            PoseLate(start=0.1, duration=0.1, delay=0.05, position_noise=0, rotation_noise_deg=0),
            lambda t: turning(t - 0.05),
        ),
        (
            PoseJump(start=0.1, duration=0.1, by=[0.1, 0, 0], turn_deg=180, axis=[0, 0, 1]),
            lambda t: (
                RigidTransform([0.1, 0, 0])
                @ turning(t)
                @ RigidTransform(RotationMatrix.MakeZRotation(np.pi), np.zeros(3))
            ),
        ),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_a_pose_is_faulty_for_so_long_only(fault, expected):
    found = passed_on(FaultyPose(fault, 0.01), turning, 0.3, kind=RigidTransform)
    for k, X in found.items():
        t = 0.01 * k
        if not 10 <= k < 20:
            np.testing.assert_array_equal(X.GetAsMatrix4(), turning(t).GetAsMatrix4())
        elif expected(t) is None:
            assert np.isnan(X.GetAsMatrix4()[:3]).all()
        else:
            np.testing.assert_allclose(X.GetAsMatrix4(), expected(t).GetAsMatrix4(), atol=1e-9)


def test_a_frozen_pose_does_not_change_in_a_bit():
    found = passed_on(FaultyPose(PoseFrozen(start=0.1), 0.01), turning, 0.3, kind=RigidTransform)
    for k in range(11, 30):
        np.testing.assert_array_equal(found[k].GetAsMatrix4(), found[10].GetAsMatrix4())


# ---------------------------------------------------------------------------------------- fields


def numbered(t):
    """Field number k is fitted at 0.5 k [s]."""
    return f"field {int((t + 1e-9) / 0.5):02d}"


def test_late_fields_come_in_order_and_what_was_there_stays():
    """Late from 2 s to 5 s by 1.5 s: field 4 is just there, 5 is the first that is late."""
    dut = LateField(PerceptionLate(start=2.0, duration=3.0, delay=1.5), period=0.05)
    found = passed_on(dut, numbered, 6.0, period=0.1)
    for tenth, field in found.items():
        t = 0.1 * tenth
        if not 2.0 < t < 5.04:
            assert field == numbered(t), t
        else:  # looked after every 0.05 s
            known = (numbered(max(t - 1.5 - slack, 2.0)) for slack in (0.0, 0.06))
            assert field in known, t


# -------------------------------------------------------------------------------------- commands


def test_commands_are_faulty_for_so_long_only(fixed_context):
    qd = np.linspace(-1.0, 1.0, 7)
    for fault, check in (
        (CommandNan(**WINDOW), lambda v: np.isnan(v).all()),
        (CommandWild(**WINDOW), lambda v: (np.abs(v) == 1e6).all()),
    ):
        dut = faulty_command(fault, 7)
        context = fixed_context(dut, velocity=qd)
        for t in (0.0, 0.999, 2.0):
            context.SetTime(t)
            np.testing.assert_array_equal(dut.get_output_port().Eval(context), qd)
        context.SetTime(1.5)
        assert check(dut.get_output_port().Eval(context))


def scenario(text):
    few = "{n_candidates: 50, n_grasps: 8, sampler: antipodal, max_points: 120}"
    return load_scenario(
        FILE, "ReachLinearMocap", f"{{object: {{model: ball}}, perception: {few}}}", text
    )


class Clock(LeafSystem):
    """A depth image of 3 by 2 pixels, the first of which is the time [s]."""

    def __init__(self):
        super().__init__()
        model = Value(ImageDepth32F(3, 2))
        self.DeclareAbstractOutputPort("image", model.Clone, self.calc)

    def calc(self, context, output):
        image = ImageDepth32F(3, 2)
        image.mutable_data[:, :, 0] = [[context.get_time(), 2, 3], [4, 5, 6]]
        output.set_value(image)


@pytest.mark.parametrize(
    ("kind", "first", "later"),
    [(CameraFrozen, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), (CameraMirrored, [3, 2, 1.05], [3, 2, 1.9])],
)
def test_a_frozen_image_is_that_of_its_beginning_and_a_mirrored_one_the_present(kind, first, later):
    builder = DiagramBuilder()
    clock, dut = builder.AddSystem(Clock()), builder.AddSystem(FaultyDepth(kind(**WINDOW), 0.1))
    builder.Connect(clock.get_output_port(), dut.get_input_port())
    simulator = Simulator(builder.Build())
    context = dut.GetMyContextFromRoot(simulator.get_context())
    for t, row in ((0.95, [0.95, 2, 3]), (1.05, first), (1.9, later), (2.15, [2.15, 2, 3])):
        simulator.AdvanceTo(t)
        image = dut.get_output_port().Eval(context).data[:, :, 0]
        np.testing.assert_allclose(image[0], row, rtol=1e-6)


# --------------------------------------------------------------------------------------- diagram

ALL = (
    "!CameraGone {}, !MaskEmpty {}, !PoseNan {}, !PerceptionLate {}, !CommandNan {}, "
    "!CameraFrozen {}"
)


def test_without_faults_the_diagram_has_none_of_them():
    names = [system.get_name() for system in make_dynamic_grasp(scenario("{}")).GetSystems()]
    assert not [name for name in names if name.startswith("fault")]


def test_every_fault_is_put_where_it_arises():
    diagram = make_dynamic_grasp(scenario(f"{{faults: [{ALL}]}}"))
    graph: dict[str, set[str]] = {}
    for (target, _), (source, port) in diagram.connection_map().items():
        if source.get_output_port(port).get_name() != "perceived":
            graph.setdefault(source.get_name(), set()).add(target.get_name())
    for number, source, targets in (
        (0, "station", {"segmentation"}),
        (1, "station", {"segmentation"}),
        (2, "station", {"tracker"}),
        (3, "perception", {"sampler", "sequencer"}),
        (4, "controller", {"drive"}),
    ):
        assert f"fault_{number}" in graph[source]
        assert graph[f"fault_{number}"] == targets
        # Nothing goes past it, but for what takes no measurement.
        assert not graph[source] & targets
    # The cloud is made of the faulty depths.
    assert "fault_5" in graph["station"] and graph["fault_5"] == {"fault_5_cloud"}
    assert graph["fault_5_cloud"] == {"fault_0"}


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_a_solver_that_gives_up_brakes_the_arm_within_its_limits(controller):
    """For a second no command comes from the QP: the arm brakes to rest, and goes on after."""
    text = "faults: [!SolverFailure {start: 0.9, duration: 1.0}], grasp: {close: false}"
    diagram_scenario = scenario(f"{{{text}, control: {{controller: {controller}}}}}")
    diagram = make_dynamic_grasp(diagram_scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.3)
    log = diagram.GetSubsystemByName("log(drive)").FindLog(simulator.get_context())
    times, speed = log.sample_times(), log.data()[7:]
    assert np.isfinite(speed).all()
    change = np.abs(np.diff(speed, axis=1)) / 0.005
    assert (change <= IIWA_7.acceleration_limits[:, None] * (1 + 1e-9)).all()
    assert np.abs(speed[:, times < 0.9]).max() > 0.1
    assert np.abs(speed[:, (times > 1.45) & (times < 1.9)]).max() < 1e-6
    assert np.abs(speed[:, times > 1.95]).max() > 0.01


def test_a_controller_without_a_solver_cannot_have_one_that_fails():
    faulty = scenario("{faults: [!SolverFailure {}]}")
    with pytest.raises(ScenarioError, match="FaultySignal has no solver"):
        FaultInjection(DiagramBuilder(), faulty).command(faulty_command(CommandNan(), 7))
