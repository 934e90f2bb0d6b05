"""Bounding boxes of the static cell."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from pydrake.geometry import Box, HalfSpace
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.segmentation.modeled_bodies import Boxes
from feasigrasp.systems.station.cell_models import StationConfig, add_cell, robot_instances


def cell_boxes(config: StationConfig, models: Collection[str] | None = None) -> Boxes:
    """A box about each collision geometry that is fixed to the world and not the arm's base.

    Of a box that is the box itself, of anything else Drake's oriented bounding box.

    Args:
        config: The cell.
        models: Names of the models that count; None for all.
    """
    # Half the size of a box that stands for a half space [m].
    half_space = 10.0
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(config.plant, builder)
    add_cell(plant, config)
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    inspector, robot = scene_graph.model_inspector(), robot_instances(plant, config.arm)
    poses, halves, solid = [], [], []
    for body in plant.GetBodiesWeldedTo(plant.world_body()):
        name = plant.GetModelInstanceName(body.model_instance())
        if body.model_instance() in robot or (models is not None and name not in models):
            continue
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            solid.append(isinstance(shape, Box | HalfSpace))
            if isinstance(shape, HalfSpace):
                below = RigidTransform([0.0, 0.0, -half_space])
                poses.append((query.GetPoseInWorld(geometry) @ below).GetAsMatrix4())
                halves.append(np.full(3, half_space))
                continue
            box = query.ComputeObbInWorld(geometry)
            poses.append(box.pose().GetAsMatrix4())
            halves.append(box.half_width())
    if not poses:
        return Boxes.none()
    return Boxes(np.array(poses), np.array(halves), np.array(solid))
