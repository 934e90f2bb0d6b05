"""What the arm reaches, as a Meshcat scene in one HTML file that opens offline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.arrays import Array
from feasigrasp.resources import model_path
from feasigrasp.runs.replay import quiet_meshcat, write_html
from feasigrasp.systems.station.meshcat_scene import set_stage

#: Shares are shown in so many steps, each a folder of its own that can be hidden.
STEPS = 5
#: Where the camera stands and what it looks at [m], and its zoom.
CAMERA, TARGET, ZOOM = (1.3, -2.4, 1.3), (0.0, 0.0, 0.5), 2.2


def write_scene(
    points: Array, share: Array, posture: Array, spacing: float, filename: Path
) -> None:
    """Writes the arm amid spheres whose colour and size say how much is reached there.

    Only the half y > 0 has spheres, so that one looks into it.

    Args:
        points: Places, shape (n, 3) [m].
        share: Share of orientations reached there, shape (n,).
        posture: Joint positions of the arm, shape (7,) [rad].
        spacing: Distance of neighbouring points [m].
        filename: Where to write the HTML.
    """
    meshcat = quiet_meshcat()
    _publish_arm(meshcat, posture)
    colours = colormaps["viridis"]
    for i, (point, value) in enumerate(zip(points, share, strict=True)):
        if value <= 0.02 or point[1] < 0.05:
            continue
        step = min(int(value * STEPS), STEPS - 1)
        red, green, blue, _ = colours(value)
        path = f"/reached/{20 * step:02d}-{20 * (step + 1)} percent/{i}"
        radius = 0.38 * spacing * (0.25 + 0.75 * np.sqrt(value))
        meshcat.SetObject(path, Sphere(radius), Rgba(red, green, blue, 1.0))
        meshcat.SetTransform(path, RigidTransform(point))
    meshcat.SetObject("/ground", Box(2.2, 2.2, 0.002), Rgba(0.86, 0.88, 0.9, 1.0))
    meshcat.SetTransform("/ground", RigidTransform([0.0, 0.0, -0.002]))
    set_stage(meshcat, CAMERA, TARGET, ZOOM)
    write_html(meshcat, filename)


def _publish_arm(meshcat: Meshcat, posture: Array) -> None:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    directives = LoadModelDirectives(str(model_path("iiwa", "cell.dmd.yaml")))
    ProcessModelDirectives(directives, plant, parser)
    plant.Finalize()
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix="/arm")
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    arm = plant.GetModelInstanceByName("iiwa")
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), arm, posture)
    diagram.ForcedPublish(context)
    meshcat.Delete("/arm/table")
