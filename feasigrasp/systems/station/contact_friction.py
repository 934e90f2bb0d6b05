"""The friction between fingers and object, as the built station has it."""

from __future__ import annotations

from pydrake.geometry import GeometryId
from pydrake.multibody.plant import CalcContactFrictionFromSurfaceProperties, CoulombFriction

from feasigrasp.systems.station.station import Station

#: The finger whose pad is asked; the other one is made of the same.
_FINGER = "left_finger"


def contact_friction(station: Station) -> float:
    """Coulomb friction of the pair of a finger's pad and the object, as the plant combines it.

    Args:
        station: A station with model instance ``gripper``.
    """
    plant = station.plant
    gripper = plant.GetModelInstanceByName("gripper")
    finger = plant.GetBodyByName(_FINGER, gripper)
    pads = plant.GetCollisionGeometriesForBody(finger)
    surfaces = plant.GetCollisionGeometriesForBody(station.object_body)
    pair = CalcContactFrictionFromSurfaceProperties(
        _friction(station, pads[0]), _friction(station, surfaces[0])
    )
    return float(pair.dynamic_friction())


def _friction(station: Station, geometry: GeometryId) -> CoulombFriction:
    properties = station.scene_graph.model_inspector().GetProximityProperties(geometry)
    friction: CoulombFriction = properties.GetProperty("material", "coulomb_friction")
    return friction
