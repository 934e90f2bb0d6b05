"""A mask function in place of the segmentation by depth: ports, errors, the object in the cell."""

import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U

from feasigrasp.errors import CameraError, ScenarioError
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.models.segmentation.modeled_bodies import ModeledBodies
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.segmentation.foreground_segmentation import MaskSegmentation
from feasigrasp_lab.studies.segmentation import intersection_over_union

CAMERA = Camera((60.0, 60.0, 31.5, 23.5), 64, 48, 0.1, 0.007)
PAGE = Path(__file__).parents[2] / "docs/own_parts.md"
X_WC = RigidTransform([1.5, 0.0, 0.2])  # beside the arm, looking up


def context_of(mask, fixed_context, *, depth=0.4, width=64):
    """A plate before the camera in half of the image, nothing behind it."""
    dut = MaskSegmentation(mask, CAMERA, ModeledBodies(ParallelGripper()))
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    points = np.stack([(u - 31.5) / 60.0, (v - 23.5) / 60.0, np.ones_like(u, float)]) * depth
    points[:, :, 32:] = np.inf
    cloud, color = PointCloud(64 * 48), ImageRgba8U(width, 48)
    cloud.mutable_xyzs()[:] = points.reshape(3, -1) + X_WC.translation()[:, None]
    color.mutable_data[:] = np.arange(width, dtype=np.uint8)[:, None]
    context = fixed_context(
        dut,
        point_cloud=cloud,
        camera_pose=X_WC,
        position=np.zeros(7),
        gripper_state=np.array([0.085, 0.0]),
        color_image=color,
    )
    context.SetTime(1.25)
    return dut, context


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    dut = MaskSegmentation(
        lambda color, depth, time: None, CAMERA, ModeledBodies(ParallelGripper())
    )
    given, outputs = ports(dut)
    assert (list(given), list(outputs)) == documented_ports(MaskSegmentation)


def test_the_mask_gets_the_image_and_becomes_its_labels(fixed_context):
    given = []

    def mask(color, depth, time):
        given.append((color.copy(), depth.copy(), time))
        return color[:, :, 0] < 10

    dut, context = context_of(mask, fixed_context)
    labels = dut.get_output_port().Eval(context).data[:, :, 0]
    ((color, depth, time),) = given
    assert (color.shape, color.dtype, time) == ((48, 64, 3), np.uint8, 1.25)
    assert (color[:, :, 0] == np.arange(64)).all()
    np.testing.assert_allclose(depth[:, :32], 0.4, atol=1e-6)
    assert np.isinf(depth[:, 32:]).all()
    assert (labels[:, :10] == Label.OBJECT).all() and (labels[:, 10:] == Label.SURROUNDINGS).all()


def test_it_is_called_once_for_each_image_with_the_time_of_that(fixed_context):
    """However often the labels are read, and whatever else changes; before the first image, not."""
    times = []

    def mask(color, depth, time):
        times.append(time)
        return np.ones((48, 64), dtype=bool)

    dut, context = context_of(mask, fixed_context)
    found = []
    for k, stamp in enumerate([np.nan, 1.0, 1.0, 1.0, 1.5, 1.5]):
        context.SetTime(1.06 + 0.1 * k)
        dut.GetInputPort("image_time").FixValue(context, [stamp])
        dut.GetInputPort("position").FixValue(context, np.full(7, 0.01 * k))
        found.append((dut.get_output_port().Eval(context).data == Label.OBJECT).all())
    assert times == [1.0, 1.5] and found == [False, *[True] * 5]


def test_what_shows_the_robot_is_not_the_object(fixed_context):
    """The camera looks up along the arm, which stands upright at zero."""
    everything = MaskSegmentation(
        lambda color, depth, time: np.ones((48, 64), dtype=bool),
        CAMERA,
        ModeledBodies(ParallelGripper()),
    )
    cloud = PointCloud(64 * 48)
    cloud.mutable_xyzs()[:] = np.array([[0.0], [0.0], [0.5]])
    cloud.mutable_xyzs()[:, :64] = np.array([[0.8], [0.0], [0.5]])
    context = fixed_context(
        everything,
        point_cloud=cloud,
        camera_pose=RigidTransform(),
        position=np.zeros(7),
        gripper_state=np.array([0.085, 0.0]),
        color_image=ImageRgba8U(64, 48),
    )
    labels = everything.get_output_port().Eval(context).data[:, :, 0]
    assert (labels[0] == Label.OBJECT).all() and (labels[1:] == Label.ROBOT).all()


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (None, "returned NoneType"),
        (np.zeros((48, 64)), r"returned an array of float64 of shape \(48, 64\)"),
        (np.zeros((64, 48), dtype=bool), r"returned an array of bool of shape \(64, 48\)"),
        (np.zeros((48, 64, 1), dtype=bool), r"of shape \(48, 64, 1\)"),
        ([[True]], "returned list"),
    ],
)
def test_what_is_no_mask_of_the_image_is_refused(mask, message, fixed_context):
    dut, context = context_of(lambda color, depth, time: mask, fixed_context)
    with pytest.raises(CameraError, match=rf"{message}; .*bool array of shape \(48, 64\)"):
        dut.get_output_port().Eval(context)


def test_a_wrong_mask_is_told_by_the_name_of_its_function_or_class(fixed_context):
    class Network:
        def __call__(self, color, depth, time):
            return color

    for mask, name in ((Network(), "Network"), (Network().__call__, "Network.__call__")):
        dut, context = context_of(mask, fixed_context)
        with pytest.raises(CameraError, match=rf"{__name__}\..*{name} returned an array of uint8"):
            dut.get_output_port().Eval(context)


def test_an_image_of_another_size_is_refused(fixed_context):
    dut, context = context_of(lambda *image: None, fixed_context, width=32)
    with pytest.raises(CameraError, match="image of 32 x 48 pixels, but the camera has 64 x 48"):
        dut.get_output_port().Eval(context)


def test_what_cannot_be_called_is_refused():
    with pytest.raises(ScenarioError, match="segmentation is a dict; give a function"):
        make_dynamic_grasp(load_scenario("ReachLinear"), segmentation={})


def test_with_the_label_image_of_the_simulation_a_mask_is_refused():
    with pytest.raises(ScenarioError, match="give perception: {segmentation: depth}"):
        make_dynamic_grasp(load_scenario("ReachLinearMocap"), segmentation=lambda *image: None)
    with pytest.raises(ScenarioError, match="give perception: {segmentation: depth}"):
        load_scenario("ReachLinearMocap", "{parts: {segmentation: {name: 'numpy:zeros'}}}")


@pytest.fixture
def example(tmp_path, monkeypatch):
    """The documentation's mask function, in a module of the folder that the command runs in."""
    blocks = re.findall(r"```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    (code,) = (block for block in blocks if "class Yellow" in block)
    (tmp_path / "my_masks.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # and taken off the path afterwards
    return "{parts: {segmentation: {name: 'my_masks:Yellow'}}, random_seed: 1}"


def test_the_documented_mask_finds_the_object_in_the_cell(example):
    """With it there are grasps, and the mask is that of the renderer, which nothing else reads."""
    diagram = make_dynamic_grasp(load_scenario("ReachLinear", example))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.8)

    def output(system, port):
        context = system.GetMyContextFromRoot(simulator.get_context())
        return system.GetOutputPort(port).Eval(context)

    labels = output(diagram.GetSubsystemByName("foreground"), "label_image").data
    station = diagram.subsystems.station
    true = output(station, "wrist_camera.label_image").data == station.object_label
    assert intersection_over_union(labels == Label.OBJECT, true) > 0.8
    assert len(output(diagram.subsystems.sampler, "grasps")) > 0
    assert not output(diagram.subsystems.tracker, "tracking").lost


def test_the_example_of_a_network_prompts_each_image_by_the_last_mask(monkeypatch):
    """With sessions in the place of the weights: the nearest pixel first, then a middle."""
    asked = []

    class Session:
        def __init__(self, name):
            self.name = name

        def get_inputs(self):
            return [SimpleNamespace(name="image")]

        def run(self, _, inputs):
            if self.name == "e.onnx":
                assert inputs["image"].shape == (1, 3, 1024, 1024)
                return [np.zeros((1, 256, 64, 64), dtype=np.float32)]
            asked.append(inputs["point_coords"][0, 0] * 80 / 1024)
            masks = np.full((1, 2, 60, 80), -1.0)
            masks[0, 1, 20:31, 40:51] = 1.0
            return [masks, np.array([[0.2, 0.9]])]

    monkeypatch.setitem(sys.modules, "onnxruntime", SimpleNamespace(InferenceSession=Session))
    example = Path(__file__).parents[2] / "examples" / "segmentation" / "onnx_segmenter.py"
    segmenter = runpy.run_path(str(example))["Segmenter"](None, "e.onnx", "d.onnx")
    depth = np.full((60, 80), 0.8)
    depth[10, 70] = 0.3
    for _ in range(2):
        mask = segmenter(np.zeros((60, 80, 3), dtype=np.uint8), depth, 0.0)
    assert mask.shape == (60, 80) and mask.sum() == 121
    np.testing.assert_allclose(asked, [[70.0, 10.0], [45.0, 25.0]], atol=1e-3)
