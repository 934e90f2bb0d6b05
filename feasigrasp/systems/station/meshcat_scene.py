"""Shows a station in Meshcat: its illustration geometry, light, background and camera."""

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.systems.station.station import Station

#: Meshcat path of everything that the station shows.
PREFIX = "/drake/illustration"
#: Where the camera stands and what it looks at, in the world frame [m], and its zoom. Source:
#: layout.
CAMERA, TARGET, ZOOM = (1.75, -1.85, 1.15), (0.36, 0.0, 0.49), 3.1
#: Brightness of the lights; Meshcat's own wash out a white arm and leave shaded sides black.
LIGHTS = {
    "AmbientLight": 0.9,
    "FillLight": 0.6,
    "SpotLight": 10.0,
    "PointLightNegativeX": 6.0,
    "PointLightPositiveX": 6.0,
}


def add_scene(builder: DiagramBuilder, station: Station, meshcat: Meshcat) -> None:
    """Adds a visualizer named ``scene`` for the geometry of a station in the builder."""
    params = MeshcatVisualizerParams(
        role=Role.kIllustration,
        prefix=PREFIX,
        publish_period=1.0 / 32.0,
        delete_on_initialization_event=False,  # it would take the object's opacity along
    )
    scene = builder.AddNamedSystem("scene", MeshcatVisualizer(meshcat, params))
    builder.Connect(station.GetOutputPort("query_object"), scene.query_object_input_port())
    object_path = f"{PREFIX}/{station.object_body.scoped_name().get_full().replace('::', '/')}"
    meshcat.Delete(PREFIX)
    _make_translucent(station, object_path, meshcat)
    set_stage(meshcat)


def _make_translucent(station: Station, object_path: str, meshcat: Meshcat) -> None:
    inspector = station.scene_graph.model_inspector()
    frame = station.plant.GetBodyFrameIdOrThrow(station.object_body.index())
    for geometry in inspector.GetGeometries(frame, Role.kIllustration):
        path = f"{object_path}/{inspector.GetName(geometry).replace('::', '/')}"
        # On the mesh itself: its folder's opacity belongs to MeshcatVisualizer.
        # Opacity of the object, so that what is drawn on it can be seen from all sides.
        meshcat.SetProperty(f"{path}/<object>", "modulated_opacity", 0.35)


def set_stage(meshcat: Meshcat) -> None:
    """Sets background, lights and camera position [m] of the cell."""
    set_background(meshcat)
    for light, intensity in LIGHTS.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "zoom", ZOOM)
    meshcat.SetCameraPose(CAMERA, TARGET)


def set_background(meshcat: Meshcat) -> None:
    """A plain light background."""
    meshcat.SetProperty("/Background", "top_color", [0.80, 0.85, 0.90])
    meshcat.SetProperty("/Background", "bottom_color", [0.97, 0.98, 0.99])
    for clutter in ("/Grid", "/Axes"):
        meshcat.SetProperty(clutter, "visible", False)
