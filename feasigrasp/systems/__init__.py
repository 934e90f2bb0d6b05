"""Thin Drake ``LeafSystem``s and ``Diagram``s around ``feasigrasp.models``."""

from feasigrasp.lazy import TYPE_CHECKING, hand_on

if TYPE_CHECKING:
    from feasigrasp.systems.controller_inputs import ControllerInputs
    from feasigrasp.systems.dynamic_grasp import DynamicGrasp, Subsystems, make_dynamic_grasp
    from feasigrasp.systems.gp_joint_controller import GPJointController
    from feasigrasp.systems.grasp_controller import GraspController
    from feasigrasp.systems.grasp_sampler import GraspSampler
    from feasigrasp.systems.gripper_sequencer import GripperSequencer
    from feasigrasp.systems.metrics import Metrics
    from feasigrasp.systems.object_tracker import ObjectTracker
    from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
    from feasigrasp.systems.reachability_filter import ReachabilityFilter
    from feasigrasp.systems.rmm_task_controller import RMMTaskController
    from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud
    from feasigrasp.systems.station.cell_models import StationConfig
    from feasigrasp.systems.station.station import Station
    from feasigrasp.systems.velocity_drive import VelocityDrive

__all__ = [
    "ControllerInputs",
    "DynamicGrasp",
    "GPJointController",
    "GraspController",
    "GraspSampler",
    "GripperSequencer",
    "Metrics",
    "ObjectTracker",
    "PointCloudToGPDF",
    "RMMTaskController",
    "ReachabilityFilter",
    "SegmentPointCloud",
    "Station",
    "StationConfig",
    "Subsystems",
    "VelocityDrive",
    "make_dynamic_grasp",
]

__getattr__, __dir__ = hand_on(
    __name__,
    {
        "Station": "station.station",
        "StationConfig": "station.cell_models",
        "SegmentPointCloud": "segmentation.segment_point_cloud",
        "PointCloudToGPDF": "point_cloud_to_gpdf",
        "GraspSampler": "grasp_sampler",
        "ReachabilityFilter": "reachability_filter",
        "GripperSequencer": "gripper_sequencer",
        "RMMTaskController": "rmm_task_controller",
        "GPJointController": "gp_joint_controller",
        "VelocityDrive": "velocity_drive",
        "ObjectTracker": "object_tracker",
        "Metrics": "metrics",
        "ControllerInputs": "controller_inputs",
        "GraspController": "grasp_controller",
        "DynamicGrasp": "dynamic_grasp",
        "Subsystems": "dynamic_grasp",
        "make_dynamic_grasp": "dynamic_grasp",
    },
)
