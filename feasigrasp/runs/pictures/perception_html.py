"""A perception as a 3-D picture in one HTML file that needs no network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydrake.geometry import Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import BaseField, Fields, PointCloud

from feasigrasp.models.grasps.glyphs import disc, frames_along, gripper_glyph, place_copies
from feasigrasp.models.grasps.perceive import Perception
from feasigrasp.runs.pictures.dense_surface import dense_surface
from feasigrasp.runs.pictures.perception import (
    shown_grasps,
    towards_viewer,
    uncertainty_colors,
    upward,
)
from feasigrasp.runs.replay import quiet_meshcat, write_html
from feasigrasp.systems.station.meshcat_scene import set_background

#: Everything is drawn below this Meshcat path; its children can be switched off by hand.
_ROOT = "/perception"
_GRASP_COLOR, _CLOUD_COLOR = Rgba(0.06, 0.65, 0.25), np.array([[40], [50], [65]], dtype=np.uint8)
#: Radius of the discs that stand for the completed surface [m].
_DISC_RADIUS = 0.0022


def write_perception_html(perception: Perception, filename: Path) -> None:
    """Writes cloud, completed surface (coloured by uncertainty) and grasps as an HTML file.

    The object stands upright with its middle in the origin; the measured points are under
    ``/perception/cloud``, the surface under ``completion``, the grasps under ``grasps``.
    """
    meshcat = quiet_meshcat()
    # Meshcat's up is z.
    R = RotationMatrix.MakeFromOneVector(upward(perception), 2).inverse()
    middle = perception.gpdf.completion.points.mean(axis=0)
    meshcat.SetTransform(_ROOT, RigidTransform(R, -(R @ middle)))

    points = perception.cloud.points
    cloud = PointCloud(len(points), Fields(BaseField.kXYZs | BaseField.kRGBs))
    cloud.mutable_xyzs()[:] = points.T
    cloud.mutable_rgbs()[:] = _CLOUD_COLOR
    meshcat.SetObject(f"{_ROOT}/cloud", cloud, point_size=0.0015)

    surface = dense_surface(perception.gpdf)
    vertices, faces = disc(_DISC_RADIUS)
    colors = np.repeat(uncertainty_colors(perception.gpdf, surface), len(vertices), axis=0)
    frames = frames_along(surface.points, surface.normals)
    vertices, faces = place_copies(frames, vertices, faces)
    meshcat.SetTriangleColorMesh(f"{_ROOT}/completion", vertices.T, faces.T, colors.T)

    X_OG = shown_grasps(perception)
    if len(X_OG) > 0:
        vertices, faces = place_copies(X_OG, *gripper_glyph(perception.gripper))
        meshcat.SetTriangleMesh(f"{_ROOT}/grasps", vertices.T, faces.T, _GRASP_COLOR)

    set_background(meshcat)
    towards = R @ towards_viewer(perception)
    size = float(np.ptp(surface.points, axis=0).max())
    place = 2.2 * size * (towards / np.linalg.norm(towards) + np.array([0.0, 0.0, 0.15]))
    meshcat.SetCameraPose(place, np.zeros(3))
    write_html(meshcat, filename)
