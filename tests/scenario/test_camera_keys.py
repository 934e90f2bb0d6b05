"""Every key of Drake's camera schema has its effect, or is refused by one line that mends it."""

import numpy as np
import pytest
from pydrake.systems.sensors import CameraConfig, ImageDepth32F

from feasigrasp.errors import ScenarioError
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.hardware.measurements import _ImageMessage
from tests.cell import FILE, Cell

NAME = "wrist_camera"
#: Entries that change what is seen, and how to see it.
SEEN = {
    "width": ("width: 128", "label_image"),
    "height": ("height: 96", "label_image"),
    "focal": ("focal: !FovDegrees {x: 60.0, y: 40.0}", "point_cloud"),
    "center_x": ("center_x: 180.0", "point_cloud"),
    "center_y": ("center_y: 100.0", "point_cloud"),
    "clipping_near": ("clipping_near: 0.4, z_near: 0.4", "label_image"),
    "clipping_far": ("clipping_far: 0.45, z_far: 0.4", "label_image"),
    "z_near": ("z_near: 0.3", "depth_image"),
    "z_far": ("z_far: 0.4", "depth_image"),
    "X_PB": ("X_PB: {base_frame: camera::camera_optical, translation: [0, 0.02, 0]}", "pose"),
    "background": ("background: {rgba: [1, 0, 0, 1]}", "color_image"),
    "capture_offset": ("fps: 30, capture_offset: 0.04", "stamp"),
    "output_delay": ("fps: 30, output_delay: 0.02", "stamp"),
}
#: Entries that are refused, and what the line says.
REFUSED = {
    "X_BC": ("X_BC: {translation: [0.01, 0, 0]}", "moves the color image.*X_PB"),
    "X_BD": ("X_BD: {rotation: !Rpy {deg: [0, 0, 5]}}", "moves the depth image.*X_PB"),
    "renderer_class": ("renderer_class: RenderEngineGltfClient", "choose one of RenderEngineVtk"),
    "name": ("name: other", "called as its entry in cameras: rename"),
    "show_rgb": ("show_rgb: true", "leave it out, and see them with --replay"),
    "lcm_bus": ("lcm_bus: other", "leave it out"),
}
#: Those that a test of their own shows. Of the images, one has to be there: each is rendered only
#: when it is read.
OTHER = {"fps", "do_compress", "renderer_name", "rgb", "depth", "label"}


def loaded(entry):
    """A scenario whose camera has an entry, and no errors."""
    text = f"{{cameras: {{{NAME}: {{{entry}}}}}, camera_noise: {{}}}}"
    return load_scenario(FILE, "ReachLinearMocap", "{object: {model: mug}}", text)


def seen(entry):
    """Everything that a camera with an entry shows after 0.05 s."""
    cell = Cell(loaded(entry)).start()
    cell.advance(0.05)
    images = {
        name: np.array(cell.read(f"{NAME}.{name}").data)
        for name in ("depth_image", "color_image", "label_image")
    }
    cloud, pose = (cell.read(f"{NAME}.{name}") for name in ("point_cloud", "pose"))
    stamped = cell.station.HasOutputPort(f"{NAME}.stamp")
    stamp = cell.read(f"{NAME}.stamp") if stamped else np.array([cell.context.get_time()])
    return images | {"point_cloud": cloud.xyzs(), "pose": pose.GetAsMatrix4(), "stamp": stamp}


@pytest.fixture(scope="module")
def usual():
    return seen("")


def test_every_key_of_drakes_schema_is_tried():
    keys = {field.name for field in CameraConfig.__fields__}
    assert keys == SEEN.keys() | REFUSED.keys() | OTHER


@pytest.mark.parametrize("key", SEEN)
def test_it_changes_what_is_seen(key, usual):
    entry, output = SEEN[key]
    expected, found = usual[output], seen(entry)[output]
    assert found.shape != expected.shape or not np.array_equal(found, expected, equal_nan=True)


@pytest.mark.parametrize("key", REFUSED)
def test_it_is_refused_by_one_line_that_says_how_to_mend_it(key):
    entry, match = REFUSED[key]
    with pytest.raises(ScenarioError, match=f"cameras.{NAME}.*{match}") as refusal:
        loaded(entry)
    assert "\n" not in str(refusal.value)


def test_a_camera_without_any_image_is_refused():
    with pytest.raises(ScenarioError, match="neither rgb nor depth nor label.*give one of them"):
        loaded("rgb: false, depth: false, label: false")
    loaded("rgb: false, depth: true, label: false")


def test_the_frame_rate_is_that_of_the_exposures():
    """Of a camera whose images are late; the others show what is there when they are read."""
    cell = Cell(loaded("fps: 10, output_delay: 0.02")).start()
    cell.advance(0.23)
    assert cell.read(f"{NAME}.stamp")[0] == pytest.approx(0.2)


def test_the_renderer_has_the_name():
    graph = Cell(loaded("renderer_name: other")).station.GetSubsystemByName("camera_scene_graph")
    assert graph.HasRenderer("other")


def test_messages_are_compressed_or_not():
    sizes = []
    for compress in (True, False):
        camera = CameraConfig(width=64, height=48, do_compress=compress)
        system = _ImageMessage(camera, mask=False)
        context = system.CreateDefaultContext()
        system.GetInputPort("depth_image").FixValue(context, ImageDepth32F(64, 48))
        sizes.append(system.get_output_port().Eval(context).images[0].size)
    assert sizes[0] < sizes[1] == 2 * 64 * 48
