"""Shows a station in Meshcat: its illustration geometry, light, background and camera."""

from __future__ import annotations

from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    RoleAssign,
)
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.systems.station import Station

#: Meshcat path of everything that the station shows.
PREFIX = "/drake/illustration"
#: Where the camera stands and what it looks at, in the world frame [m], and its zoom.
CAMERA, TARGET, ZOOM = (1.9, -1.7, 1.15), (0.27, 0.0, 0.47), 2.2
#: Opacity of the object, so that what is drawn on it can be seen from all sides.
OBJECT_OPACITY = 0.5
#: Brightness of the lights that stand at a point; Meshcat's own wash out a white arm.
LIGHTS = {"SpotLight": 12.0, "PointLightNegativeX": 10.0, "PointLightPositiveX": 10.0}


def add_scene(builder: DiagramBuilder, station: Station, meshcat: Meshcat) -> str:
    """Adds a visualizer named ``scene`` for the station's geometry.

    Args:
        builder: The builder that holds the station.
        station: What to show.
        meshcat: Where to show it.

    Returns:
        The Meshcat path that moves with the object: its frame is the object frame O.
    """
    params = MeshcatVisualizerParams(
        role=Role.kIllustration, prefix=PREFIX, publish_period=1.0 / 32.0
    )
    scene = builder.AddNamedSystem("scene", MeshcatVisualizer(meshcat, params))
    builder.Connect(station.GetOutputPort("query_object"), scene.query_object_input_port())
    _make_translucent(station)
    _set_stage(meshcat)
    return f"{PREFIX}/{station.object_body.scoped_name().get_full().replace('::', '/')}"


def _make_translucent(station: Station) -> None:
    scene_graph, plant, body = station.scene_graph, station.plant, station.object_body
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    for geometry in inspector.GetGeometries(frame, Role.kIllustration):
        properties = inspector.GetIllustrationProperties(geometry)
        color = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(0.8, 0.8, 0.8))
        faint = Rgba(color.r(), color.g(), color.b(), OBJECT_OPACITY)
        properties.UpdateProperty("phong", "diffuse", faint)
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _set_stage(meshcat: Meshcat) -> None:
    meshcat.SetProperty("/Background", "top_color", [0.80, 0.85, 0.90])
    meshcat.SetProperty("/Background", "bottom_color", [0.97, 0.98, 0.99])
    for clutter in ("/Grid", "/Axes"):
        meshcat.SetProperty(clutter, "visible", False)
    for light, intensity in LIGHTS.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "zoom", ZOOM)
    meshcat.SetCameraPose(CAMERA, TARGET)
