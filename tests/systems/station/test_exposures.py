"""Cameras whose images come late: their schedule, and images of the instant of exposure."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.systems.sensors import ImageDepth32F
from pydrake.trajectories import PiecewisePolynomial

from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.station.exposures import CameraPose, Exposures, FirstImage, Timing
from tests.cell import FILE, Cell

NAME = "wrist_camera"
IMAGES = ("depth_image", "label_image", "color_image")


def test_ports_are_those_of_the_docstrings(ports, documented_ports, seeing):
    camera = seeing.scenario.cameras[NAME]
    for system in (
        Exposures(Timing(30.0, 0.0, 0.06), np.zeros(2)),
        FirstImage(ImageDepth32F(4, 3)),
        CameraPose(seeing.station.plant, NAME, camera, seeing.station.arm),
    ):
        inputs, outputs = ports(system)
        assert (list(inputs), list(outputs)) == documented_ports(type(system))


@pytest.mark.parametrize(
    "timing",
    [(5.0, 0.0, 0.05), (30.0, 0.0, 0.06), (30.0, 0.0, 0.1), (10.0, 0.03, 0.0), (10.0, 0.25, 0.31)],
    ids=str,
)
def test_the_schedule_is_drakes(timing):
    """Image i is of ``capture_offset + i / fps``, and is there ``output_delay`` later.

    The second to last has no delay, those before and after it one that is longer than the time
    between images.
    """
    fps, offset, delay = timing
    builder = DiagramBuilder()
    clock = PiecewisePolynomial.FirstOrderHold([0.0, 10.0], [[0.0, 10.0]])
    source = builder.AddSystem(TrajectorySource(clock))
    dut = builder.AddSystem(Exposures(Timing(*timing), np.array([-1.0])))
    builder.Connect(source.get_output_port(), dut.get_input_port())
    simulator = Simulator(builder.Build())
    context = dut.GetMyContextFromRoot(simulator.get_context())
    exposures = offset + np.arange(60) / fps
    for t in np.arange(0.0, 1.2, 0.0171) + 1e-3:  # beside the instants of arrival
        simulator.AdvanceTo(t)
        there = exposures[exposures + delay < t]
        stamp, y = (dut.GetOutputPort(name).Eval(context)[0] for name in ("stamp", "y"))
        if len(there) == 0:
            assert np.isnan(stamp) and y == -1.0
        else:
            assert stamp == pytest.approx(there[-1], abs=1e-9)
            assert y == pytest.approx(there[-1], abs=1e-9)


def cell(text):
    """A carried object in fast motion, before a camera with errors; the arm moves too."""
    camera = f"{{cameras: {{{NAME}: {{{text}}}}}, camera_noise: {{{NAME}: {{}}}}}}"
    motion = "{object: {model: mug}, motion: {rate: 3.0}, carrier: {kind: hand, hue: 315.0}}"
    depth = "{perception: {segmentation: depth}, random_seed: 3}"
    started = Cell(load_scenario(FILE, "ReachLinearMocap", motion, depth, camera)).start()
    q = started.read("arm.position_measured")
    started.fix("arm.desired_state", np.r_[q + 0.05, np.zeros(7)])
    return started


def test_images_are_those_of_the_instant_of_exposure():
    """Bit for bit what an immediate camera shows then: object, carrier, arm and errors."""
    late, prompt = cell("fps: 25, output_delay: 0.1"), cell("")
    late.advance(0.05)
    assert np.isnan(late.read(f"{NAME}.stamp")[0])
    assert np.isinf(late.read(f"{NAME}.depth_image").data).all()
    assert not np.isfinite(late.read(f"{NAME}.point_cloud").xyzs()).any()
    assert len(np.unique(late.read(f"{NAME}.label_image").data)) == 1
    late.advance(0.23)
    prompt.advance(0.12)
    assert late.read(f"{NAME}.stamp")[0] == pytest.approx(0.12)
    for name in (*IMAGES, "point_cloud", "pose"):
        ours, expected = (each.read(f"{NAME}.{name}") for each in (late, prompt))
        if name == "pose":
            np.testing.assert_array_equal(ours.GetAsMatrix4(), expected.GetAsMatrix4())
        elif name == "point_cloud":
            np.testing.assert_array_equal(ours.xyzs(), expected.xyzs())
        else:
            np.testing.assert_array_equal(ours.data, expected.data)
    for name, of in (
        ("position", "arm.position_measured"),
        ("gripper_state", "gripper.state_measured"),
    ):
        np.testing.assert_array_equal(late.read(f"{NAME}.{name}"), prompt.read(of))
    # Where the camera is now is not where it was.
    prompt.advance(0.23)
    now, expected = late.read(f"{NAME}.pose_now"), prompt.read(f"{NAME}.pose")
    np.testing.assert_allclose(now.GetAsMatrix4(), expected.GetAsMatrix4(), atol=1e-9)
    assert np.linalg.norm(now.translation() - late.read(f"{NAME}.pose").translation()) > 1e-3


def test_an_image_that_is_read_twice_is_the_same_twice():
    late = cell("fps: 10, output_delay: 0.05")
    late.advance(0.06)
    first = late.read(f"{NAME}.depth_image").data.copy()
    late.advance(0.14)
    np.testing.assert_array_equal(late.read(f"{NAME}.depth_image").data, first)
    late.advance(0.16)
    assert (late.read(f"{NAME}.depth_image").data != first).any()
