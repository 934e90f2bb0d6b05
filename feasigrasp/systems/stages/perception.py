"""From the camera's image to grasps on the object."""

from __future__ import annotations

from pydrake.systems.framework import LeafSystem, OutputPort

from feasigrasp.errors import ScenarioError
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.scenario.schema import Segmentation
from feasigrasp.systems.from_scenario import (
    make_camera,
    make_foreground_segmentation,
    make_grasp_sampler,
    make_object_pixels,
    make_scene,
)
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
from feasigrasp.systems.stages.cell import Cell, accepted, given
from feasigrasp.systems.stages.remote import remote_scene, remote_tracker
from feasigrasp.systems.station.pose_at import PoseAt


def add_perception(
    cell: Cell,
    field: LeafSystem,
    sampler: GraspSamplerFn | None = None,
    *,
    tracks_elsewhere: bool = False,
) -> OutputPort:
    """Camera -> object's points -> distance field, which it returns -> grasps, all in O.

    Args:
        cell: The cell.
        field: What fits a field to the points.
        sampler: From the field to grasps; None where ``field`` tells grasps as well.
        tracks_elsewhere: Whether the tracker, which looks at images that are segmented by their
            depth, does so in another process.
    """
    station, config, scene_config = cell.station, cell.scenario.perception, cell.scenario.scene
    cloud, labels, camera_pose = (
        station.GetOutputPort(f"{config.camera}.{name}")
        for name in ("point_cloud", "label_image", "pose")
    )
    label, no_scene = station.object_label, station.robot_and_object_labels()
    cloud = cell.faults.cloud(cloud, labels, camera_pose, label)
    if config.segmentation == Segmentation.DEPTH:
        no_scene = [Label.OBJECT, Label.ROBOT, Label.UNCLEAR, Label.CARRIER]
        foreground = make_foreground_segmentation(cell.scenario, cell.gripper, mask=cell.mask)
        labels = cell.builder.AddNamedSystem("foreground", foreground).get_output_port()
        segment = make_object_pixels(cell.scenario)
    else:
        segment = SegmentPointCloud(label, camera=make_camera(cell.scenario), hiding=no_scene)
    images = {"point_cloud": cloud, "label_image": cell.faults.mask(labels, segment.label)}
    segmentation = cell.add("segmentation", segment, **images)
    cell.builder.AddNamedSystem("perception", field)
    tracker, seen_pose = cell["tracker"], _pose_at_view(cell)
    if tracker.HasInputPort("point_cloud"):  # it looks at images
        cell.connect(field, tracker)
        image = {
            "depth_image": cell.port(f"{config.camera}.depth_image"),
            "image_time": cell.port(f"{config.camera}.stamp"),
        }
        there = given(camera_pose=camera_pose, **image)
        cell.connect(tracker, segmentation, field, **accepted(tracker, **there))
    else:
        stamp = cell.port(f"{config.camera}.stamp") if cell.remote else None
        seen = given(camera_pose=camera_pose, object_pose=seen_pose, stamp=stamp)
        cell.connect(field, segmentation, tracker, **seen)
    gpdf = cell.faults.field(field.GetOutputPort("gpdf"))
    if config.segmentation == Segmentation.DEPTH:
        seen = given(
            point_cloud=cloud,
            camera_pose=camera_pose,
            position=cell.port(f"{config.camera}.position") or cell.port("iiwa.position_measured"),
            gripper_state=cell.port("gripper.state_measured"),
            gpdf=gpdf,
            color_image=_color_image(cell, config.camera),
        )
        cell.connect(foreground, tracker, **accepted(foreground, object_pose=seen_pose, **seen))
        second = _second_images(cell)
        if second and tracker.HasInputPort("second_point_cloud") and not tracks_elsewhere:
            _add_second_camera(cell, object_pose=seen_pose, gpdf=gpdf, **second)
        if tracks_elsewhere:
            elsewhere = remote_tracker(cell)
            there = {f"second_{name}": port for name, port in second.items()}
            images = accepted(elsewhere, **seen, **there, **given(**image))
            cell.add("remote_tracker", elsewhere, field, **images)
            cell.connect(elsewhere, **given(stamp=cell.port(f"{config.camera}.stamp")))
            cell.connect(tracker, elsewhere)
    if sampler is not None:
        cell.add("sampler", make_grasp_sampler(cell.scenario, sampler, cell.gripper), gpdf=gpdf)
    grasps = cell["sampler" if sampler else "perception"].GetOutputPort("grasps")
    cell.add("latency", cell.late(GraspSet.empty()), u=grasps)
    if scene_config.enabled:
        if cell.remote:
            scene = remote_scene(cell, no_scene)
        else:
            scene = make_scene(cell.scenario, cell.gripper, no_scene)
        position = station.GetOutputPort("iiwa.position_measured")
        cell.add("scene_perception", scene, camera_pose=camera_pose, position=position, **images)
    return gpdf


def _second_images(cell: Cell) -> dict[str, OutputPort]:
    """What the second camera tells, by the names of the ports that take it; empty without one."""
    name = cell.scenario.perception.second_camera
    if not name:
        return {}
    return given(
        point_cloud=cell.port(f"{name}.point_cloud"),
        camera_pose=cell.port(f"{name}.pose"),
        position=cell.port(f"{name}.position") or cell.port("iiwa.position_measured"),
        color_image=_color_image(cell, name),
        depth_image=cell.port(f"{name}.depth_image"),
        image_time=cell.port(f"{name}.stamp"),
    )


def _add_second_camera(
    cell: Cell,
    *,
    point_cloud: OutputPort,
    camera_pose: OutputPort,
    depth_image: OutputPort,
    image_time: OutputPort | None = None,
    **inputs: OutputPort,
) -> None:
    """Lets the tracker see the object's points in the second camera's images."""
    name, tracker = cell.scenario.perception.second_camera, cell["tracker"]
    gripper = cell.port("gripper.state_measured")
    images = {"point_cloud": point_cloud, "camera_pose": camera_pose}
    foreground = make_foreground_segmentation(cell.scenario, cell.gripper, name, cell.mask)
    there = accepted(foreground, **images, **inputs, **given(gripper_state=gripper))
    cell.add("second_foreground", foreground, tracker, **there)
    segmentation = cell.add(
        "second_segmentation",
        make_object_pixels(cell.scenario, name),
        point_cloud=point_cloud,
        label_image=foreground.get_output_port(),
    )
    cell.connect(
        tracker,
        second_point_cloud=segmentation.GetOutputPort("point_cloud"),
        second_camera_pose=camera_pose,
        second_depth_image=depth_image,
        **given(second_image_time=image_time),
    )


def _color_image(cell: Cell, camera: str) -> OutputPort | None:
    """A camera's colour image, where a mask function or a carrier's hue needs it.

    Raises:
        ScenarioError: The cell has none.
    """
    hue = cell.scenario.carrier.hue
    if hue is None and not cell.masked:
        return None
    port = cell.port(f"{camera}.color_image")
    if port is None and cell.masked:
        raise ScenarioError(
            f"parts.segmentation looks at colors, but {camera} of this cell sends none; have the "
            "camera's driver send the masks, with perception: {segmentation: labels}, see "
            "docs/hardware.md"
        )
    if port is None:
        raise ScenarioError(
            f"carrier.hue is {hue:g}, but {camera} of this cell sends no colour image; leave it out"
        )
    return port


def _pose_at_view(cell: Cell) -> OutputPort:
    """The object's pose when the image was taken, which is now where images have no stamp."""
    tracker = cell["tracker"]
    if tracker.HasOutputPort("pose_at_view"):
        return tracker.GetOutputPort("pose_at_view")
    pose = tracker.GetOutputPort("object_pose")
    stamp = cell.port(f"{cell.scenario.perception.camera}.stamp")
    if stamp is None:
        return pose
    seen = PoseAt(cell.scenario.control.period)
    return cell.add("pose_at_view", seen, pose=pose, stamp=stamp).get_output_port()
