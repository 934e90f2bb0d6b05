"""Friction between the gripper and what it holds.

Drake combines the coefficients of two surfaces to ``2 a b / (a + b)``, which is the wanted one if
both have it: so both are given it.
"""

from __future__ import annotations

from pydrake.geometry import GeometryId, RoleAssign, SceneGraph
from pydrake.multibody.plant import (
    CalcContactFrictionFromSurfaceProperties,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import ModelInstanceIndex


def set_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, instance: ModelInstanceIndex, friction: float
) -> None:
    """Gives all collision geometry of a model one Coulomb friction, static and dynamic.

    Args:
        plant: The plant that holds the model.
        scene_graph: The scene graph that the plant is registered with.
        instance: The model.
        friction: The coefficient.
    """
    inspector = scene_graph.model_inspector()
    for geometry in _surfaces(plant, instance):
        properties = inspector.GetProximityProperties(geometry)
        properties.UpdateProperty(
            "material", "coulomb_friction", CoulombFriction(friction, friction)
        )
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def contact_friction(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    one: ModelInstanceIndex,
    other: ModelInstanceIndex,
) -> float:
    """The Coulomb friction of contacts between two models, as the plant computes it.

    It is the static coefficient, the only one that a discrete plant uses; the largest one, if the
    pairs of their surfaces differ.
    """
    inspector = scene_graph.model_inspector()
    ones, others = (
        [
            inspector.GetProximityProperties(geometry).GetProperty("material", "coulomb_friction")
            for geometry in _surfaces(plant, instance)
        ]
        for instance in (one, other)
    )
    return max(
        float(CalcContactFrictionFromSurfaceProperties(a, b).static_friction())
        for a in ones
        for b in others
    )


def _surfaces(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[GeometryId]:
    bodies = map(plant.get_body, plant.GetBodyIndices(instance))
    return [g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)]
