"""Draws all objects of a folder, to one scale, into one picture (Drake's VTK renderer)."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from feasigrasp.models.objects.rigid_object import RigidObject, find_objects, load_object
from feasigrasp.systems.station.object_model import add_object

_EYE = np.array([0.30, -0.50, 0.28])  # camera position relative to the object [m]
_PIXELS = 420
_COLUMNS = 6


def draw_sheet(folder: Path, picture: Path) -> None:
    """Renders every object of ``folder`` from the same viewpoint and labels the tiles."""
    objects = [load_object(path) for path in find_objects(folder).values()]
    rows = -(-len(objects) // _COLUMNS)
    figure, axes = plt.subplots(rows, _COLUMNS, figsize=(2.1 * _COLUMNS, 2.3 * rows))
    for axis in axes.flat:
        axis.axis("off")
    for axis, obj, image in zip(axes.flat, objects, _render(objects), strict=False):
        axis.imshow(image)
        size = " x ".join(f"{100 * e:.1f}" for e in obj.extents)
        axis.set_title(f"{obj.name}\n{size} cm, {1000 * obj.mass:.0f} g", fontsize=8)
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.93, wspace=0.03, hspace=0.16)
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=100)
    plt.close(figure)


def _render(objects: list[RigidObject]) -> list[np.ndarray]:
    """One RGB image per object; the objects stand 5 m apart, out of each other's view."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    lights = [
        LightParameter(type="directional", direction=[0.3, 0.8, 1.0], intensity=0.9),
        LightParameter(type="directional", direction=[-0.8, 0.2, 1.0], intensity=0.4),
    ]
    params = RenderEngineVtkParams(default_clear_color=np.ones(3), lights=lights)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(params))
    z_WC = -_EYE / np.linalg.norm(_EYE)
    x_WC = np.cross(z_WC, [0, 0, 1]) / np.linalg.norm(np.cross(z_WC, [0, 0, 1]))
    R_WC = RotationMatrix(np.column_stack([x_WC, np.cross(z_WC, x_WC), z_WC]))
    core = RenderCameraCore(
        "vtk", CameraInfo(_PIXELS, _PIXELS, 0.36), ClippingRange(0.05, 3.0), RigidTransform()
    )
    with tempfile.TemporaryDirectory() as directory:
        for i, obj in enumerate(objects):
            instance = add_object(plant, obj, directory=directory, model_name=obj.name)
            body = plant.GetBodyByName("object", instance)
            plant.WeldFrames(
                plant.world_frame(), body.body_frame(), RigidTransform([5.0 * i, 0.0, 0.0])
            )
        plant.Finalize()
        diagram = builder.Build()
        context = scene_graph.GetMyContextFromRoot(diagram.CreateDefaultContext())
        query = scene_graph.get_query_output_port().Eval(context)
        images = []
        for i, obj in enumerate(objects):
            middle = (obj.vertices.min(axis=0) + obj.vertices.max(axis=0)) / 2
            X_WC = RigidTransform(R_WC, np.array([5.0 * i, 0, 0]) + middle + _EYE)
            image = query.RenderColorImage(
                ColorRenderCamera(core), scene_graph.world_frame_id(), X_WC
            )
            images.append(np.array(image.data[..., :3]))
    return images
