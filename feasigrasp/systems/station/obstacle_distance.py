"""How far the arm is from its surroundings, as the simulation's own geometry says."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pydrake.geometry import GeometryId, QueryObject
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.systems.ports import declare_input


class ObstacleDistance(LeafSystem):
    """Smallest distance between the arm, with all it carries, and what is fixed to the world.

    .. pydrake_system::

        name: ObstacleDistance
        input_ports:
        - query_object
        output_ports:
        - distance

    ``distance`` [m] is signed, negative for penetration, and infinite if nothing is there. It is
    asked of Drake for every pair of collision geometries; what the controllers know of the scene
    plays no part. Bodies that are welded to the world, such as the arm's base, do not count as arm,
    and neither arm nor object counts as surroundings.
    """

    def __init__(self, plant: MultibodyPlant, robot: Iterable[ModelInstanceIndex]) -> None:
        """A measurement in the scene of a finalized plant.

        Args:
            plant: The plant.
            robot: Model instances of the arm and what it carries.
        """
        super().__init__()
        robot = list(robot)
        fixed = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.world_body())}
        self._moving: list[GeometryId] = []
        self._surroundings: list[GeometryId] = []
        for instance in map(ModelInstanceIndex, range(plant.num_model_instances())):
            for index in plant.GetBodyIndices(instance):
                geometries = plant.GetCollisionGeometriesForBody(plant.get_body(index))
                if int(index) not in fixed:
                    self._moving += geometries if instance in robot else []
                elif instance not in robot:
                    self._surroundings += geometries
        self._query = declare_input(self, "query_object", QueryObject())
        self.DeclareVectorOutputPort("distance", 1, self._calc)

    def _calc(self, context: Context, output) -> None:
        query = self._query.Eval(context)
        nearest = np.inf
        for a in self._moving:
            for b in self._surroundings:
                pair = query.ComputeSignedDistancePairClosestPoints(a, b)
                nearest = min(nearest, pair.distance)
        output.SetAtIndex(0, nearest)
