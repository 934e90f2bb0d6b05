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


def _same(system: str, *ports: str) -> dict[str, str]:
    """Inputs that are called as the outputs of a system that they are connected to."""
    return {port: f"{system}.{port}" for port in ports}


def _images(camera: str, cloud: str, color: str, depth: str) -> dict[str, str]:
    """Images of a camera, and the measured arm at their instant."""
    return {
        "point_cloud": cloud,
        "color_image": color,
        "depth_image": depth,
        "image_time": f"{camera}.stamp",
        "camera_pose": f"{camera}.pose",
        "position": f"{camera}.position | {_POSITION}",
        "gripper_state": f"{camera}.gripper_state | {_FINGERS}",
    }


#: Images of perception's two cameras.
CAMERA = _images("camera", "cloud", "color", "depth")
_SECOND = _images("second", "second.point_cloud", "second_color", "second.depth_image")
#: What is known of the object when an image is segmented.
_TRACKED = {"object_pose": _POSE_AT_VIEW, "tracking": "tracker.tracking", "gpdf": "field"}
#: What is known of the object's motion.
_MOVING = {
    **_same("tracker", "object_pose", "object_velocity"),
    "object_motion": "predictor.object_motion | tracker.object_motion",
}

#: What a controller is given, and a planner in a process of its own.
_CONTROLLER = {
    "position": _POSITION,
    **_same("sequencer", "grasps", "object_pose", "object_velocity", "object_motion"),
    **_same("sequencer", "phase", "gpdf", "search_target"),
    "tracking": "tracker.tracking",
    "camera_pose": "hand_camera",
    "desired_velocity": "drive.desired_velocity",
    "touch": "contact_sense.touch",
    "scene": "scene_perception.scene",
    "static_obstacles": "static_obstacles.y0",
    "plan": "planner.plan",
}
_IN_SCENE = {"object_pose": "tracker.object_pose", "scene": "scene_perception.scene"}

#: By system and input port: where it comes from.
CONNECTIONS: dict[str, dict[str, str]] = {
    # Images -> the object's points -> its pose and its completed surface.
    "foreground": CAMERA | _TRACKED,
    "segmentation": {"point_cloud": "cloud", "label_image": "labels", "depth_image": "depth"},
    "second_foreground": _SECOND | _TRACKED,
    "second_segmentation": {
        **_same("second", "point_cloud", "depth_image"),
        "label_image": "second_foreground.label_image",
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
    "predictor": _same("tracker", "object_pose", "object_velocity", "object_motion"),
    "pose_at_view": {"pose": "tracker.object_pose", "stamp": "camera.stamp"},
    "perception": {
        **_same("segmentation", "point_cloud", "outline"),
        "image_time": "camera.stamp",
        "camera_pose": "camera.pose",
        "object_pose": _POSE_AT_VIEW,
        **_same("tracker", "tracking", "keyframe"),
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
    "clear_grasps": {"grasps": "carrying.grasps | latency.y", **_IN_SCENE},
    "reachability": {
        "grasps": "clear_grasps.grasps | carrying.grasps | latency.y",
        **_MOVING,
        "position": _POSITION,
        "desired_velocity": "drive.desired_velocity",
    },
    "clear_hand_poses": {"grasps": "reachability.grasps", **_IN_SCENE},
    "reachable": {"u": "clear_hand_poses.grasps | reachability.grasps"},
    # Grasps -> what the controller follows -> arm and gripper.
    "sequencer": {
        "grasps": "reachable.y",
        **_MOVING,
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
        **_same("sequencer", "phase", "search_target"),
        **_same("tracker", "object_pose", "tracking"),
        "perceived": "perception.perceived",
        "scene": "scene_perception.scene",
        **_same("drive", "command_faults", "desired_velocity"),
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
