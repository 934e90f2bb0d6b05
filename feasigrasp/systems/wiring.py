"""Table of all connections of the diagram, in the order of the picture in README.

Nothing else connects systems of the pipeline. A source is ``system.port``; ``camera.port`` and
``second.port`` are ports of the station's two cameras, and a word without a dot is a signal of this
scenario (`feasigrasp.systems.pipeline.Cell`), such as a port behind a fault. Of several sources,
separated by ``|``, the first that this diagram has is taken; an input without a source stays open.
"""

from collections.abc import Mapping

from pydrake.systems.framework import DiagramBuilder, OutputPort, System

#: The object's pose when the image was taken.
_POSE_AT_VIEW = "tracker.pose_at_view | pose_at_view.pose | tracker.object_pose"
_POSITION = "station.arm.position_measured"
_FINGERS = "station.gripper.state_measured"

#: Images of perception's two cameras, and the measured arm at their instant.
CAMERA = {
    "point_cloud": "cloud",
    "color_image": "color",
    "depth_image": "depth",
    "image_time": "camera.stamp",
    "camera_pose": "camera.pose",
    "position": f"camera.position | {_POSITION}",
    "gripper_state": f"camera.gripper_state | {_FINGERS}",
}
_SECOND = {
    "point_cloud": "second.point_cloud",
    "color_image": "second_color",
    "depth_image": "second.depth_image",
    "image_time": "second.stamp",
    "camera_pose": "second.pose",
    "position": f"second.position | {_POSITION}",
    "gripper_state": f"second.gripper_state | {_FINGERS}",
}
#: What is known of the object when an image is segmented.
_TRACKED = {"object_pose": _POSE_AT_VIEW, "tracking": "tracker.tracking", "gpdf": "field"}

#: What a controller is given, and a planner in a process of its own.
_CONTROLLER = {
    "position": _POSITION,
    "grasps": "sequencer.grasps",
    "object_pose": "sequencer.object_pose",
    "object_velocity": "sequencer.object_velocity",
    "object_motion": "sequencer.object_motion",
    "phase": "sequencer.phase",
    "gpdf": "sequencer.gpdf",
    "search_target": "sequencer.search_target",
    "tracking": "tracker.tracking",
    "camera_pose": "hand_camera",
    "desired_velocity": "drive.desired_velocity",
    "touch": "contact_sense.touch",
    "scene": "scene_perception.scene",
    "static_obstacles": "static_obstacles.y0",
    "plan": "planner.plan",
}

#: By system and input port: where it comes from.
CONNECTIONS: dict[str, dict[str, str]] = {
    # Images -> the object's points -> its pose and its completed surface.
    "foreground": CAMERA | _TRACKED,
    "segmentation": {"point_cloud": "cloud", "label_image": "labels", "depth_image": "depth"},
    "second_foreground": _SECOND | _TRACKED,
    "second_segmentation": {
        "point_cloud": "second.point_cloud",
        "label_image": "second_foreground.label_image",
        "depth_image": "second.depth_image",
    },
    "tracker": {
        "pose": "measured_pose",
        "stamp": "station.object.stamp",
        "point_cloud": "segmentation.point_cloud",
        "depth_image": "depth",
        "image_time": "camera.stamp",
        "camera_pose": "camera.pose",
        "second_point_cloud": "second_segmentation.point_cloud",
        "second_depth_image": "second.depth_image",
        "second_image_time": "second.stamp",
        "second_camera_pose": "second.pose",
        "perceived": "perception.perceived",
        "phase": "hand_phase",
        "track": "remote_tracker.track",
    },
    "remote_tracker": {
        **CAMERA,
        **{f"second_{name}": source for name, source in _SECOND.items()},
        "stamp": "camera.stamp",
        "perceived": "perception.perceived",
        "gpdf": "field",
        "phase": "hand_phase",
    },
    "predictor": {
        "object_pose": "tracker.object_pose",
        "object_velocity": "tracker.object_velocity",
        "object_motion": "tracker.object_motion",
    },
    "pose_at_view": {"pose": "tracker.object_pose", "stamp": "camera.stamp"},
    "perception": {
        "point_cloud": "segmentation.point_cloud",
        "outline": "segmentation.outline",
        "image_time": "camera.stamp",
        "camera_pose": "camera.pose",
        "object_pose": _POSE_AT_VIEW,
        "tracking": "tracker.tracking",
        "keyframe": "tracker.keyframe",
        "stamp": "remote_stamp",
    },
    "scene_perception": {
        "point_cloud": "cloud",
        "label_image": "labels",
        "camera_pose": "camera.pose",
        "position": _POSITION,
    },
    # The completed surface -> grasps -> those that the hand can take now.
    "sampler": {"gpdf": "field"},
    "latency": {"u": "sampler.grasps | perception.grasps", "stamp": "exposed"},
    "carrying": {"grasps": "latency.y", "object_pose": "tracker.object_pose"},
    "clear_grasps": {
        "grasps": "carrying.grasps | latency.y",
        "object_pose": "tracker.object_pose",
        "scene": "scene_perception.scene",
    },
    "reachability": {
        "grasps": "clear_grasps.grasps | carrying.grasps | latency.y",
        "object_pose": "tracker.object_pose",
        "object_velocity": "tracker.object_velocity",
        "object_motion": "predictor.object_motion | tracker.object_motion",
        "position": _POSITION,
        "desired_velocity": "drive.desired_velocity",
    },
    "clear_hand_poses": {
        "grasps": "reachability.grasps",
        "object_pose": "tracker.object_pose",
        "scene": "scene_perception.scene",
    },
    "reachable": {"u": "clear_hand_poses.grasps | reachability.grasps"},
    # Grasps -> what the controller follows -> arm and gripper.
    "sequencer": {
        "grasps": "reachable.y",
        "object_pose": "tracker.object_pose",
        "object_velocity": "tracker.object_velocity",
        "object_motion": "predictor.object_motion | tracker.object_motion",
        "tracking": "tracker.tracking",
        "gpdf": "field",
        "perceived": "perception.perceived",
        "position": _POSITION,
        "gripper_state": _FINGERS,
        "lapsed": "lapsed.sum",
        "arrival": "controller.arrival",
    },
    "contact_sense": {"torque_external": "station.arm.torque_external", "phase": "sequencer.phase"},
    "planner": _CONTROLLER,
    "controller": _CONTROLLER,
    "drive": {"velocity": "velocity", "position": _POSITION},
    "station": {
        "arm.desired_state": "drive.desired_state",
        "gripper.position": "sequencer.gripper_position",
        "object.hold": "sequencer.object_hold",
    },
    # What a run says, and what it is judged by.
    "status": {
        "position": _POSITION,
        "grasps": "latency.y",
        "verdicts": "reachability.verdicts",
        "reachable": "sequencer.grasps",
        "phase": "sequencer.phase",
        "search_target": "sequencer.search_target",
        "object_pose": "tracker.object_pose",
        "tracking": "tracker.tracking",
        "perceived": "perception.perceived",
        "scene": "scene_perception.scene",
        "command_faults": "drive.command_faults",
        "desired_velocity": "drive.desired_velocity",
        "touches": "contact_sense.touches",
        "lapsed": "lapsed.sum",
        "contradicted": "foreground.contradicted",
    },
    "true_pose_at_view": {"pose": "station.object.pose", "stamp": "tracker.stamp"},
    "true_frame": {
        "object_pose": "station.object.pose",
        "pose_at_view": "true_pose_at_view.pose | station.object.pose",
        "tracked_pose": "tracker.object_pose",
        "track": "tracker.track",
    },
    "view_time(latency)": {"u": "perception.view_time", "stamp": "exposed"},
    "view_time(reachable)": {"u": "view_time(latency).y"},
    "metrics": {
        "state": "station.arm.state_estimated",
        "object_pose": "station.object.pose",
        "frame_pose": "true_frame.frame_pose",
        "tracked_pose": "tracker.object_pose",
        "phase": "sequencer.phase | handover.phase",
        "grasps": "sequencer.grasps | handover.grasps",
        "sampled_grasps": "latency.y",
        "view_time": "view_time(reachable).y",
    },
    "obstacle_distance": {"query_object": "station.query_object"},
    "contact": {
        "contact_results": "station.contact_results",
        "phase": "sequencer.phase | handover.phase",
    },
    "visualizer": {
        "perceived": "perception.perceived",
        "object_pose": "tracker.object_pose",
        "phase": "sequencer.phase",
        "grasps": "latency.y",
        "reachable": "sequencer.grasps",
    },
    "camera_pictures": {"color_image": "camera.color_image", "label_image": "labels"},
}
#: An input of one's own controller that is not listed takes the output of that name of these.
_BY_NAME = ("sequencer", "tracker", "drive", "contact_sense", "scene_perception", "planner")


def connect_all(
    builder: DiagramBuilder, signals: Mapping[str, OutputPort], cameras: Mapping[str, str]
) -> None:
    """Connects the systems of a builder by the table `CONNECTIONS`; others are left alone.

    The ``signals`` are the sources without a dot that this diagram has, the ``cameras`` what
    ``camera`` and ``second`` are called in the station.
    """
    systems: dict[str, System] = {system.get_name(): system for system in builder.GetSystems()}

    def port_of(source: str) -> OutputPort | None:
        name, dot, port = source.partition(".")
        if not dot:
            return signals.get(name)
        if name in cameras:
            name, port = "station", f"{cameras[name]}.{port}"
        there = name in systems and systems[name].HasOutputPort(port)
        return systems[name].GetOutputPort(port) if there else None

    for name, inputs in CONNECTIONS.items():
        if name not in systems:
            continue
        by_name = _BY_NAME if inputs is _CONTROLLER else ()
        for port in map(systems[name].get_input_port, range(systems[name].num_input_ports())):
            listed = inputs.get(port.get_name())
            sources = listed.split(" | ") if listed else [f"{s}.{port.get_name()}" for s in by_name]
            if output := next(filter(None, map(port_of, sources)), None):
                builder.Connect(output, port)
