"""Draws a station, the completed surface and the grasps in Meshcat."""

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Rgba, Role
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.grasps.glyphs import (
    disc,
    frames_along,
    gripper_glyph,
    place_copies,
    spread_order,
)
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.point_cloud_to_gpdf import Perceived
from feasigrasp.systems.ports import add_connected, declare_input, weakly
from feasigrasp.systems.station.station import Station

#: Colours of grasps that the controller is given, and of those that were dropped before. Source:
#: layout.
REACHABLE, DROPPED = Rgba(0.10, 0.80, 0.25), Rgba(0.35, 0.35, 0.40, 0.4)
#: Colours of completed surface that was seen, and that was made up. Source: layout.
SEEN, INVENTED = np.array([0.10, 0.50, 1.0]), np.array([1.0, 0.15, 0.55])
#: Meshcat path of what is perceived; its frame is the object frame O.
PATH = "/drake/perceived"


class _Flipbook:
    """Pictures of one thing that change with time, of which one is visible.

    Meshcat's recordings hold properties but no geometry, so every picture gets its own path and
    the recording makes it visible and invisible again.
    """

    def __init__(self, meshcat: Meshcat, path: str) -> None:
        self._meshcat, self._path = meshcat, path
        self._count = 0

    def clear(self) -> None:
        self._meshcat.Delete(self._path)
        self._count = 0

    def turn(self, time: float) -> str:
        """Hides the present picture and returns the path for the next."""
        self.hide(time)
        path = f"{self._path}/{self._count}"
        self._count += 1
        if time > 0.0:
            self._meshcat.SetProperty(path, "visible", False, 0.0)
        self._meshcat.SetProperty(path, "visible", True, time)
        return path

    def hide(self, time: float) -> None:
        """Shows nothing from now on."""
        if self._count > 0:
            self._meshcat.SetProperty(f"{self._path}/{self._count - 1}", "visible", False, time)


class GraspVisualizer(LeafSystem):
    """Shows completed surface and grasp candidates in Meshcat, at the estimated pose.

    .. pydrake_system::

        name: GraspVisualizer
        input_ports: [perceived, grasps, reachable, phase, object_pose]

    ``perceived`` is a `Perceived`; ``grasps`` are all sampled grasps and ``reachable`` those that
    the controller is given, flips included, both in the object frame O; ``phase`` is a `Phase`, and
    ``object_pose`` X_WO the tracker's estimate: how far what is drawn lies beside the object is
    how wrong it is. While it is not finite, what is drawn stays where it is.
    The completed surface is drawn as discs, from blue where it was seen to pink where it is made
    up. Grasps that the controller is given are green, dropped ones faint grey; while the fingers
    close only the grasp that the hand committed to is drawn, and none after the object was let go.
    Everything is drawn below `PATH`, and is part of a recording that runs.
    """

    #: Most grasps drawn: enough to show their variety, few enough to see the object.
    MAX_REACHABLE, MAX_DROPPED = 8, 4

    def __init__(self, meshcat: Meshcat, gripper: Gripper) -> None:
        super().__init__()
        self._meshcat = meshcat
        self._glyph = gripper_glyph(gripper)
        self._cloud = _Flipbook(meshcat, f"{PATH}/completion")
        self._good = _Flipbook(meshcat, f"{PATH}/grasps/reachable")
        self._bad = _Flipbook(meshcat, f"{PATH}/grasps/dropped")
        self._forget()
        self._perceived = declare_input(self, "perceived", kind=Perceived)
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._reachable = declare_input(self, "reachable", GraspSet.empty())
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self.DeclareInitializationPublishEvent(weakly(self._clear))
        # Time between two pictures [s].
        self.DeclarePeriodicPublishEvent(0.25, 0.0, weakly(self._draw))
        # Time between two places of it, as between those of the arm [s].
        self.DeclarePeriodicPublishEvent(1.0 / 32.0, 0.0, weakly(self._move))

    def _forget(self) -> None:
        self._drawn_gpdf: Gpdf | None = None
        self._ordered: tuple[GraspSet | None, Indices] = (None, np.zeros(0, np.int64))
        self._drawn_grasps: bytes | None = None

    def _clear(self, context: Context) -> None:
        for book in (self._cloud, self._good, self._bad):
            book.clear()
        self._forget()

    def _move(self, context: Context) -> EventStatus:
        X_WO = self._pose.Eval(context)
        if not np.isfinite(X_WO.GetAsMatrix34()).all():
            return EventStatus.DidNothing()
        self._meshcat.SetTransform(PATH, X_WO, context.get_time())
        return EventStatus.Succeeded()

    def _draw(self, context: Context) -> None:
        time = context.get_time()
        gpdf = self._perceived.Eval(context).gpdf
        if gpdf is not None and gpdf is not self._drawn_gpdf:
            self._drawn_gpdf = gpdf
            draw_surface(self._meshcat, self._cloud.turn(time), gpdf)
        grasps, reachable = self._grasps.Eval(context), self._reachable.Eval(context)
        match Phase(int(self._phase.Eval(context)[0])):
            case Phase.APPROACH:
                mask = reachable_mask(grasps, reachable)
                # The reachable subset lags the grasps by a tick: then keep what is drawn.
                if mask.any() or len(reachable) == 0:
                    order = self._order(grasps)
                    self._draw_grasps(
                        time,
                        grasps.X_OG[order[mask[order]][: self.MAX_REACHABLE]],
                        grasps.X_OG[order[~mask[order]][: self.MAX_DROPPED]],
                    )
            case Phase.CLOSE:
                self._draw_grasps(time, reachable.X_OG[:1], reachable.X_OG[:0])
            case _:
                self._draw_grasps(time, reachable.X_OG[:0], reachable.X_OG[:0])

    def _order(self, grasps: GraspSet) -> Indices:
        """An order that stays the same as long as the set does, so that glyphs do not flicker."""
        if self._ordered[0] is not grasps:
            self._ordered = (grasps, spread_order(grasps.X_OG, grasps.score))
        return self._ordered[1]

    def _draw_grasps(self, time: float, good: Array, bad: Array) -> None:
        key = good.tobytes() + b"|" + bad.tobytes()
        if key == self._drawn_grasps:
            return
        self._drawn_grasps = key
        for book, X_OG, color in ((self._good, good, REACHABLE), (self._bad, bad, DROPPED)):
            if len(X_OG) == 0:
                book.hide(time)
                continue
            vertices, faces = place_copies(X_OG, *self._glyph)
            self._meshcat.SetTriangleMesh(book.turn(time), vertices.T, faces.T, color)


def draw_surface(meshcat: Meshcat, path: str, gpdf: Gpdf) -> None:
    """Draws the completed surface of a field as discs."""
    surface, one = gpdf.completion, disc(0.0045)
    # A millimetre outside, where the object's own skin does not hide them.
    frames = frames_along(surface.points + 0.001 * surface.normals, surface.normals)
    vertices, faces = place_copies(frames, *one)
    colors = np.repeat(surface_colors(gpdf), len(one[0]), axis=0)
    meshcat.SetTriangleColorMesh(path, vertices.T, faces.T, colors.T)


def reachable_mask(grasps: GraspSet, reachable: GraspSet) -> Mask:
    """Mask of grasps in a subset of them and their flips, shape (n,)."""
    subset = {X_OG.tobytes() for X_OG in reachable.X_OG}
    both = grasps.with_symmetric().X_OG
    found = np.array([X_OG.tobytes() in subset for X_OG in both], dtype=bool)
    return found[: len(grasps)] | found[len(grasps) :]


def distance_from_seen(gpdf: Gpdf, points: Array) -> Array:
    """Distance of points (n, 3) from the observations, by their variance, shape (n,) [m].

    At a distance r from a single observation the variance is ``1 - exp(-2 r / l)``, solved for r.
    """
    return -gpdf.length_scale / 2.0 * np.log1p(-np.clip(gpdf.variance(points), 0.0, 0.999))


def surface_colors(gpdf: Gpdf) -> Array:
    """Colors of the completed points by their variance, shape (n, 3)."""
    # Distance to the observed surface [m] at which a point counts as observed, and as made up.
    seen_within, invented_beyond = 0.002, 0.010
    distance = distance_from_seen(gpdf, gpdf.completion.points)
    share = (distance - seen_within) / (invented_beyond - seen_within)
    share = np.clip(share, 0.0, 1.0)[:, None]
    return (1.0 - share) * SEEN + share * INVENTED


#: Meshcat path of everything that the station shows.
PREFIX = "/drake/illustration"
#: Brightness of the lights; Meshcat's own wash out a white arm and leave shaded sides black.
LIGHTS = {
    "AmbientLight": 0.9,
    "FillLight": 0.6,
    "SpotLight": 10.0,
    "PointLightNegativeX": 6.0,
    "PointLightPositiveX": 6.0,
}


def add_scene(builder: DiagramBuilder, station: Station, meshcat: Meshcat) -> None:
    """Adds a visualizer named ``scene`` for the geometry of a station, and lights."""
    params = MeshcatVisualizerParams(
        role=Role.kIllustration,
        prefix=PREFIX,
        publish_period=1.0 / 32.0,
        delete_on_initialization_event=False,  # it would take the object's opacity along
    )
    query = station.GetOutputPort("query_object")
    add_connected(builder, "scene", MeshcatVisualizer(meshcat, params), query)
    object_path = f"{PREFIX}/{station.object_body.scoped_name().get_full().replace('::', '/')}"
    meshcat.Delete(PREFIX)
    _make_translucent(station, object_path, meshcat)
    set_background(meshcat)
    for light, intensity in LIGHTS.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    meshcat.SetProperty("/Cameras/default/rotated/<object>", "zoom", 3.1)
    meshcat.SetCameraPose(camera_in_world=[1.75, -1.85, 1.15], target_in_world=[0.36, 0.0, 0.49])


def _make_translucent(station: Station, object_path: str, meshcat: Meshcat) -> None:
    inspector = station.scene_graph.model_inspector()
    frame = station.plant.GetBodyFrameIdOrThrow(station.object_body.index())
    for geometry in inspector.GetGeometries(frame, Role.kIllustration):
        path = f"{object_path}/{inspector.GetName(geometry).replace('::', '/')}"
        # On the mesh itself: its folder's opacity belongs to MeshcatVisualizer.
        # Opacity of the object, so that what is drawn on it can be seen from all sides.
        meshcat.SetProperty(f"{path}/<object>", "modulated_opacity", 0.35)


def set_background(meshcat: Meshcat) -> None:
    """A plain light background."""
    meshcat.SetProperty("/Background", "top_color", [0.80, 0.85, 0.90])
    meshcat.SetProperty("/Background", "bottom_color", [0.97, 0.98, 0.99])
    for clutter in ("/Grid", "/Axes"):
        meshcat.SetProperty(clutter, "visible", False)
