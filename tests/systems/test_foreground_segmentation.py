"""The segmentation as a system: its ports, in place of the label image, the object in the cell."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.models.segmentation.modeled_bodies import Boxes, ModeledBodies
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.segmentation.foreground_segmentation import ForegroundSegmentation
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
from feasigrasp_lab.studies.segmentation import first_mask_iou, intersection_over_union

FILE = diagram_path("dynamic.scenarios.yaml")
CAMERA = Camera((60.0, 60.0, 31.5, 23.5), 64, 48, 0.1, 0.007)
DEPTH = "{perception: {segmentation: depth}}"
#: Of a camera whose images are there at once, so that there is one at the start.
AT_ONCE = "{cameras: {wrist_camera: {output_delay: 0.0}}}"


@pytest.fixture(scope="module")
def dut():
    return ForegroundSegmentation(CAMERA, ModeledBodies(ParallelGripper()))


def plate(at=0.4, first_column=10):
    """A plate before the camera, 0.3 by 0.15 m at 0.9 m, nothing behind it."""
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    points = np.stack([(u - 31.5) / 60.0, (v - 23.5) / 60.0, np.ones_like(u, float)]) * at
    points[:, :, :first_column] = np.inf
    points[:, :, first_column + 20 :] = np.inf
    points[:, 10:] = np.inf
    cloud = PointCloud(64 * 48)
    cloud.mutable_xyzs()[:] = points.reshape(3, -1)
    return cloud, np.isfinite(points[0])


def inputs(cloud):
    return {
        "point_cloud": cloud,
        "camera_pose": RigidTransform(),
        "position": np.zeros(7),
        "gripper_state": np.array([0.085, 0.0]),
        "object_pose": RigidTransform(np.full((3, 4), np.nan)),
        "tracking": Tracking(TrackingState.SEARCHING, np.inf),
        "gpdf": None,
        "color_image": ImageRgba8U(64, 48),
    }


def test_ports_are_those_of_the_docstring(dut, ports, documented_ports):
    given, outputs = ports(dut)
    assert (list(given), list(outputs)) == documented_ports(ForegroundSegmentation)
    assert given["position"] == 7 and given["gripper_state"] == 2


def test_its_label_image_fits_the_port_of_the_point_cloud(dut, fixed_context):
    # An arm at zero stands along the z axis, through which the camera looks up: beside it is free.
    cloud, shown = plate(at=0.9, first_column=42)
    context = fixed_context(dut, **inputs(cloud))
    labels = dut.GetOutputPort("label_image").Eval(context)
    assert set(np.unique(labels.data)) <= {int(label) for label in Label}
    segment = SegmentPointCloud(Label.OBJECT)
    of_object = fixed_context(segment, point_cloud=cloud, label_image=labels)
    kept = segment.GetOutputPort("point_cloud").Eval(of_object)
    labelled = np.count_nonzero(labels.data[:, :, 0] == Label.OBJECT)
    assert 0.8 * labelled < kept.size() <= labelled  # but for its edges
    assert kept.size() > 0.5 * shown.sum()


def test_a_cloud_of_another_size_is_refused(dut, fixed_context):
    context = fixed_context(dut, **inputs(PointCloud(5)))
    with pytest.raises(ValueError, match="5 points.*64 x 48 pixels"):
        dut.GetOutputPort("label_image").Eval(context)


def test_without_any_depth_nothing_is_the_object(dut, fixed_context):
    cloud = PointCloud(64 * 48)
    cloud.mutable_xyzs()[:] = np.inf
    labels = dut.GetOutputPort("label_image").Eval(fixed_context(dut, **inputs(cloud)))
    assert (labels.data == Label.SURROUNDINGS).all()


@pytest.mark.parametrize(("depth", "named"), [(0.5, False), (0.55, False), (0.7, True)])
def test_images_that_look_through_the_cell_are_not_used(fixed_context, depth, named):
    """A wall is 0.5 m away; from the third image that shows it farther away on it is said."""
    wall = np.eye(4)
    wall[2, 3] = 1.0
    cell = Boxes(wall[None], np.array([[2.0, 2.0, 0.5]]), np.array([True]))
    dut = ForegroundSegmentation(CAMERA, ModeledBodies(ParallelGripper(), cell), period=0.1)
    image = ImageDepth32F(64, 48)
    image.mutable_data[:] = depth
    context = fixed_context(dut, **inputs(plate(depth)[0]) | {"depth_image": image})
    simulator, reported = Simulator(dut, context), []
    for k in range(6):
        simulator.AdvanceTo(0.1 * k + 0.05)
        reported.append(dut.GetOutputPort("contradicted").Eval(context))
    assert reported == [False, False, *[named] * 4]
    unclear = dut.GetOutputPort("label_image").Eval(context).data == Label.UNCLEAR
    assert unclear.all() == named
    image.mutable_data[:] = 0.5
    image.mutable_data[4, 4] = 0.7  # the camera sees so far
    dut.GetInputPort("depth_image").FixValue(context, image)
    simulator.AdvanceTo(0.75)
    assert not dut.GetOutputPort("contradicted").Eval(context)


@pytest.mark.parametrize(("name", "seed"), [("ReachLinearMocap", 0), ("ReachObstacleMocap", 1)])
def test_the_first_mask_in_the_cell(name, seed):
    """Of a drill, whose first view is in pieces; no model says that there is a wall."""
    text = f"{{random_seed: {seed}, object: {{model: drill}}}}"
    assert first_mask_iou(load_scenario(FILE, name, DEPTH, text)) > 0.85


def test_intersection_over_union():
    one, other = np.zeros((2, 4), dtype=bool), np.zeros((2, 4), dtype=bool)
    assert intersection_over_union(one, other) == 1.0
    one[0], other[:, 0] = True, True
    assert intersection_over_union(one, other) == pytest.approx(1 / 5)
    assert intersection_over_union(one, one) == 1.0


def test_in_the_diagram_it_takes_the_place_of_the_label_image():
    diagram = make_dynamic_grasp(load_scenario(FILE, "ReachLinearMocap", DEPTH))
    context = diagram.CreateDefaultContext()
    foreground, station = map(diagram.GetSubsystemByName, ("foreground", "station"))
    of_station = station.GetMyContextFromRoot(context)
    points = diagram.GetSubsystemByName("segmentation").GetOutputPort("point_cloud")
    seen = points.Eval(diagram.GetSubsystemByName("segmentation").GetMyContextFromRoot(context))
    labels = foreground.GetOutputPort("label_image").Eval(foreground.GetMyContextFromRoot(context))
    truth = station.GetOutputPort("wrist_camera.label_image").Eval(of_station)
    mask = truth.data == int(station.object_body.index())
    assert intersection_over_union(labels.data == Label.OBJECT, mask) > 0.8
    middle = station.GetOutputPort("object.pose").Eval(of_station).translation()
    assert seen.size() > 500
    assert np.linalg.norm(seen.xyzs().mean(axis=1) - middle) < 0.06


def masks(diagram, context, *others):
    """Of the object, as it was found, and how many pixels of it show each of some labels."""
    foreground, station = map(diagram.GetSubsystemByName, ("foreground", "station"))
    found = foreground.GetOutputPort("label_image").Eval(foreground.GetMyContextFromRoot(context))
    of_station = station.GetMyContextFromRoot(context)
    truth = station.GetOutputPort("wrist_camera.label_image").Eval(of_station).data
    mask = found.data == Label.OBJECT
    return mask, [np.count_nonzero(mask & (truth == label)) for label in others]


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("ReachLinearCarried", "soup_can"),
        ("ReachLinearCarried", "banana"),
        ("ReachLinearCarried", "l_block"),  # its hue is nearest to that of the hand
        ("ReachLinearBelt", "mug"),
        ("ReachLinearBelt", "small_box"),
    ],
)
def test_the_first_mask_of_a_carried_object_has_next_to_nothing_of_the_carrier(name, model):
    diagram = make_dynamic_grasp(
        load_scenario(FILE, name, f"{{object: {{model: {model}}}}}", AT_ONCE)
    )
    station = diagram.GetSubsystemByName("station")
    of_object, of_carrier = station.object_label, station.plant.num_bodies()
    context = diagram.CreateDefaultContext()
    mask, (right, wrong) = masks(diagram, context, of_object, of_carrier)
    assert right > 300
    assert wrong < 0.03 * np.count_nonzero(mask)


def test_a_hand_whose_hue_is_not_known_is_taken_for_a_part_of_what_it_holds():
    """What it cannot do, see docs/limitations.md."""
    text = "{object: {model: soup_can}, carrier: {hue: null}}"
    diagram = make_dynamic_grasp(load_scenario(FILE, "ReachLinearCarried", text, AT_ONCE))
    carrier = diagram.GetSubsystemByName("station").plant.num_bodies()
    mask, (wrong,) = masks(diagram, diagram.CreateDefaultContext(), carrier)
    assert wrong > 0.3 * np.count_nonzero(mask)


@pytest.mark.parametrize("name", ["ReachLinearBeside", "ReachLinearAlong"])
def test_of_two_objects_that_is_chosen_which_moves_nearest_to_the_hand(name):
    diagram = make_dynamic_grasp(load_scenario(FILE, name, "{object: {model: soup_can}}"))
    station = diagram.GetSubsystemByName("station")
    of_object, other = station.object_label, station.plant.num_bodies()
    simulator = Simulator(diagram)
    simulator.Initialize()
    mask, _ = masks(diagram, simulator.get_context())
    assert not mask.any()  # both rest as yet
    simulator.AdvanceTo(0.8)
    mask, (right, wrong) = masks(diagram, simulator.get_context(), of_object, other)
    assert right > 300
    assert wrong <= 0.01 * np.count_nonzero(mask)
