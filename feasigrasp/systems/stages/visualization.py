"""What Meshcat shows, and what a replay shows beside it."""

from __future__ import annotations

from pydrake.geometry import Meshcat

from feasigrasp.systems.monitoring.camera_pictures import CameraPictures
from feasigrasp.systems.monitoring.grasp_visualizer import GraspVisualizer
from feasigrasp.systems.stages.cell import Cell
from feasigrasp.systems.station.meshcat_scene import add_scene


def add_visualization(cell: Cell, meshcat: Meshcat) -> None:
    """Shows the cell, and on the object what perception and reachability make of it."""
    add_scene(cell.builder, cell.station, meshcat)
    cell.add(
        "visualizer",
        GraspVisualizer(meshcat, cell.gripper),
        cell["perception"],
        cell["tracker"],
        cell["sequencer"],
        grasps=cell["latency"].get_output_port(),
        reachable=cell["sequencer"].GetOutputPort("grasps"),
    )
    camera = cell.scenario.perception.camera
    cell.add(
        "camera_pictures",
        CameraPictures(cell["segmentation"].label),
        color_image=cell.station.GetOutputPort(f"{camera}.color_image"),
        label_image=cell.source("segmentation", "label_image"),
    )
