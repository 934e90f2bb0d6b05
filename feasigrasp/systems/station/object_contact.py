"""Contact of arm and hand with the object before closing, from the contact solver."""

import itertools
from collections.abc import Iterable

import numpy as np
from pydrake.geometry import QueryObject, Role
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.systems.ports import declare_input, declare_output, weakly


def _geometries(plant: MultibodyPlant, index: BodyIndex) -> list[int]:
    """The collision geometries of a body, as numbers: Drake's ids would keep the plant alive."""
    return [i.get_value() for i in plant.GetCollisionGeometriesForBody(plant.get_body(index))]


class ObstacleDistance(LeafSystem):
    """Smallest distance between the arm with its attachments and static bodies.

    .. pydrake_system::

        name: ObstacleDistance
        input_ports: [query_object]
        output_ports: [distance]

    ``distance`` [m] is signed, negative for penetration, and infinite if nothing is there. It is
    asked of Drake for every pair of collision geometries; what the controllers know of the scene
    plays no part. Bodies that are welded to the world, such as the arm's base, do not count as arm,
    and neither arm nor object counts as surroundings.
    """

    def __init__(self, plant: MultibodyPlant, robot: Iterable[ModelInstanceIndex]) -> None:
        """A measurement in the scene of a finalized plant, for model instances of the robot."""
        super().__init__()
        robot = list(robot)
        fixed = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.world_body())}
        self._moving: list[int] = []
        self._surroundings: list[int] = []
        for instance in map(ModelInstanceIndex, range(plant.num_model_instances())):
            for index in plant.GetBodyIndices(instance):
                geometries = _geometries(plant, index)
                if int(index) not in fixed:
                    self._moving += geometries if instance in robot else []
                elif instance not in robot:
                    self._surroundings += geometries
        self._query = declare_input(self, "query_object", QueryObject())
        declare_output(self, "distance", self._calc, size=1)

    def _calc(self, context: Context) -> float:
        query = self._query.Eval(context)
        ids = query.inspector().GetAllGeometryIds(Role.kProximity)
        moving = [i for i in ids if i.get_value() in self._moving]
        surroundings = [i for i in ids if i.get_value() in self._surroundings]
        closest = query.ComputeSignedDistancePairClosestPoints
        pairs = itertools.product(moving, surroundings)
        return min((closest(a, b).distance for a, b in pairs), default=np.inf)


class ObjectContact(LeafSystem):
    """Sums up the contact of a robot's bodies with the object at every step of the plant.

    .. pydrake_system::

        name: ObjectContact
        input_ports: [contact_results, phase]
        output_ports: [approach]

    ``phase`` is a `Phase`. ``approach`` has four entries, over all past steps of the plant in
    which the hand approached: how long they were, how long of it the robot touched the object [s],
    the largest norm of the summed contact force [N], and the integral of that norm [N s]. Contacts
    of both kinds count, hydroelastic and of points.
    """

    def __init__(
        self, plant: MultibodyPlant, body_index: BodyIndex, robot: Iterable[ModelInstanceIndex]
    ) -> None:
        """A measurement on a finalized, discrete plant, of a body and instances of the robot."""
        super().__init__()
        self._object = body_index
        self._robot = {index for instance in robot for index in plant.GetBodyIndices(instance)}
        bodies = (body_index, *self._robot)
        self._body_of = {each: index for index in bodies for each in _geometries(plant, index)}
        self._step = plant.time_step()
        self._results = declare_input(self, "contact_results", ContactResults())
        self._phase = self.DeclareVectorInputPort("phase", 1)
        state = self.DeclareDiscreteState(4)
        # With the plant's own steps: the solver's result is computed once for both of them.
        self.DeclarePeriodicDiscreteUpdateEvent(self._step, 0.0, weakly(self._update))
        self.DeclareStateOutputPort("approach", state)

    def touches(self, results: ContactResults) -> bool:
        """Whether the robot touches the object."""
        return bool(np.any(self.force(results)))

    def force(self, results: ContactResults) -> Array:
        """Force of the robot on the object [N], in the world frame, shape (3,)."""
        force = np.zeros(3)
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            surface = info.contact_surface()
            ids = surface.id_M().get_value(), surface.id_N().get_value()
            bodies = self._body_of.get(ids[0]), self._body_of.get(ids[1])
            force -= self._sign(*bodies) * info.F_Ac_W().translational()  # on the first
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            sign = self._sign(pair.bodyA_index(), pair.bodyB_index())
            force += sign * pair.contact_force()  # on the second
        return force

    def _sign(self, a: BodyIndex | None, b: BodyIndex | None) -> int:
        """1 for a body of the robot and the object, -1 the other way round, 0 for other pairs."""
        if a in self._robot and b == self._object:
            return 1
        return -1 if a == self._object and b in self._robot else 0

    def _update(self, context: Context, state) -> EventStatus:
        # Fingers that grasp touch all the time; to look at that in every step would cost a lot.
        if self._phase.Eval(context)[0] != Phase.APPROACH:
            return EventStatus.DidNothing()
        results = self._results.Eval(context)
        any_contact = results.num_hydroelastic_contacts() + results.num_point_pair_contacts() > 0
        force = float(np.linalg.norm(self.force(results))) if any_contact else 0.0
        time, touched, peak, impulse = state.value()
        touched += self._step * (force > 0.0)
        impulse += self._step * force
        state.set_value([time + self._step, touched, max(peak, force), impulse])
        return EventStatus.Succeeded()
