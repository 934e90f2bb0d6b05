"""Independent reference model of the robot, for collision and torque metrics.

Nothing here is shared with what controls the arm or with what the simulation collides: the shapes
are cut out of the visible meshes, the distances and the gravity torques are Drake's.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations, pairwise

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.geometry import (
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
    Role,
)
from pydrake.multibody.parsing import (
    ModelDirective,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path


def self_collision_metrics(reference: ReferenceRobot, Q: Array) -> dict[str, float | None]:
    """``self_collision_percent`` and ``self_distance_min_mm`` of joint positions (n, 7) [rad].

    The distance is None where it never falls below 5 cm; that of the forearm and the flange does
    not count as one.
    """
    distances = reference.self_distances(Q, 0.05)
    names = [{reference.names[a], reference.names[b]} for a, b in reference.pairs]
    # Forearm and flange: the one turns in the other's fork, 3.6 cm away for most of the way.
    links = reference.arm.link_names
    checked = distances[:, [pair != {links[-3], links[-1]} for pair in names]]
    nearest = float(checked.min(initial=np.inf))
    return {
        "self_collision_percent": 100.0 * float(np.mean((distances < 0.0).any(axis=1))),
        "self_distance_min_mm": 1e3 * nearest if np.isfinite(nearest) else None,
    }


def torque_metrics(
    reference: ReferenceRobot, Q: Array, actuation: Array
) -> dict[str, float | None]:
    """``torque_limit_violation_percent`` and ``torque_peak_percent``.

    The simulated arm is weightless, a real one is not: what its motors would bear is the simulated
    actuation (m, 7) [Nm], and the weight of arm, hand and camera at positions Q (m, 7) [rad].
    """
    share = np.abs(actuation + reference.gravity_torques(Q)) / reference.arm.effort_limits
    clamped = np.abs(actuation) / reference.arm.effort_limits
    # Torques are clamped at their limits, so what comes this near has reached them (relative).
    beyond = np.maximum(share, clamped) >= 1.0 - 1e-6
    return {
        "torque_limit_violation_percent": 100.0 * float(np.mean(beyond.any(axis=1))),
        "torque_peak_percent": 100.0 * float(share.max()),
    }


#: The hand's bodies in the order of `HAND_NAMES`.
_HAND = ("gripper_body", "left_finger", "right_finger", "camera_body")
#: Of how many slices across its z-axis the hulls of a body are made, if not of the whole: the hull
#: of the whole forearm would fill the fork in which the wrist turns, that of the first link the
#: waist above the base.
SLICES = {"iiwa_link_1": 12, "iiwa_link_5": 12}


def reference_robot(directives: Sequence[ModelDirective], arm: Arm = IIWA_7) -> ReferenceRobot:
    """The reference model of a cell, cached per process."""
    return _reference_robot(yaml_dump_typed(ModelDirectives(directives=list(directives))), arm)


@lru_cache(maxsize=4)
def _reference_robot(text: str, arm: Arm) -> ReferenceRobot:
    return ReferenceRobot(yaml_load_typed(schema=ModelDirectives, data=text).directives, arm)


class ReferenceRobot:
    """Arm, gripper with open fingers, and camera, as a cell's directives describe them.

    Attributes:
        arm: The arm.
        names: Bodies of the robot, the base first.
        pairs: Those of them that are not neighbours, as places in ``names``, shape (p, 2).
            Neighbours move with the same link, or with links that a joint connects.
    """

    def __init__(self, directives: Sequence[ModelDirective], arm: Arm = IIWA_7) -> None:
        """Loads the cell anew."""
        self.arm = arm
        builder = DiagramBuilder()
        self.plant, self._scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        parser = Parser(self.plant)
        parser.package_map().AddPackageXml(str(model_path("package.xml")))
        ProcessModelDirectives(ModelDirectives(directives=list(directives)), self.plant, parser)
        instances = [
            self.plant.GetModelInstanceByName(name)
            for name in (arm.name, "gripper", "camera")
            if self.plant.HasModelInstanceNamed(name)
        ]
        self._arm = instances[0]
        bodies = [self.plant.get_body(k) for i in instances for k in self.plant.GetBodyIndices(i)]
        hulls = [self._add_hulls(body) for body in bodies]
        self.plant.Finalize()
        seen = [k for k, own in enumerate(hulls) if own]
        self.names = [bodies[k].name() for k in seen]
        self.pairs = self._keep_apart([bodies[k] for k in seen], [hulls[k] for k in seen])
        self._of = {hull: n for n, k in enumerate(seen) for hull in hulls[k]}
        diagram = builder.Build()
        self._root = diagram.CreateDefaultContext()
        self._context = self.plant.GetMyContextFromRoot(self._root)
        for instance in instances[1:]:
            upper = self.plant.GetPositionsFromArray(instance, self.plant.GetPositionUpperLimits())
            self.plant.SetPositions(self._context, instance, upper)

    def self_distances(self, Q: Array, below: float = np.inf) -> Array:
        """Signed distances of the pairs at positions Q (n, 7) [rad], shape (n, p) [m].

        Those not ``below`` [m] do not matter, cost little, and are infinite.
        """
        scene = self._scene_graph.GetMyContextFromRoot(self._root)
        place = {frozenset(pair): k for k, pair in enumerate(map(tuple, self.pairs.tolist()))}
        found = np.full((len(Q), len(place)), np.inf)
        for row, q in zip(found, Q, strict=True):
            self.plant.SetPositions(self._context, self._arm, q)
            query = self._scene_graph.get_query_output_port().Eval(scene)
            for near in query.ComputeSignedDistancePairwiseClosestPoints(below):
                k = place[frozenset((self._of[near.id_A], self._of[near.id_B]))]
                row[k] = min(row[k], near.distance)
        return found

    def gravity_torques(self, Q: Array) -> Array:
        """Torques (n, 7) [Nm] that bear arm, hand and camera at rest, by Q (n, 7) [rad]."""
        torques = np.empty((len(Q), self.arm.joints))
        for row, q in zip(torques, Q, strict=True):
            self.plant.SetPositions(self._context, self._arm, q)
            weight = self.plant.CalcGravityGeneralizedForces(self._context)
            row[:] = -self.plant.GetVelocitiesFromArray(self._arm, weight)
        return torques

    def _add_hulls(self, body: RigidBody) -> list[GeometryId]:
        """Gives a body the hulls of its visual geometry as collision geometry; capsules as such."""
        inspector = self._scene_graph.model_inspector()
        hulls: list[GeometryId] = []
        for visual in self.plant.GetVisualGeometriesForBody(body):
            shape, X_BV = inspector.GetShape(visual), inspector.GetPoseInFrame(visual)
            pieces = [shape] if isinstance(shape, Capsule) else []
            if isinstance(shape, Mesh):
                pieces = slices(shape, SLICES.get(body.name(), 1))
            for piece in pieces:
                name = f"hull {len(hulls)} of {inspector.GetName(visual)}"
                given = body, X_BV, piece, name, ProximityProperties()
                hulls.append(self.plant.RegisterCollisionGeometry(*given))
        return hulls

    def _keep_apart(self, bodies: list[RigidBody], hulls: list[list[GeometryId]]) -> Array:
        """Lets the hulls of bodies that are not neighbours collide, and nothing else."""
        links = {name: k for k, name in enumerate(self.arm.link_names)}
        carried = self.arm.joints  # the hand and the camera move with the last link
        link = [links.get(body.name(), carried) for body in bodies]
        pairs = [(a, b) for a, b in combinations(range(len(bodies)), 2) if link[b] - link[a] >= 2]
        if len(self.arm.inertias):  # seen as its capsules, some of which always overlap
            hand = {name: carried + 1 + k for k, name in enumerate(_HAND)}
            number = [(links | hand)[body.name()] for body in bodies]
            pairs = [(a, b) for a, b in pairs if (number[a], number[b]) in self.arm.pairs]
        inspector = self._scene_graph.model_inspector()
        everything = GeometrySet(inspector.GetAllGeometryIds(Role.kProximity))
        filters = self._scene_graph.collision_filter_manager()
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(everything))
        for a, b in pairs:
            between = GeometrySet(hulls[a]), GeometrySet(hulls[b])
            filters.Apply(CollisionFilterDeclaration().AllowBetween(*between))
        return np.array(pairs)


def slices(shape: Mesh, n: int) -> list[Convex]:
    """Convex hulls of ``n`` slices of a mesh; together they hold all its triangles."""
    mesh = trimesh.load_mesh(shape.source().path(), process=False)
    if shape.extension() == ".gltf":
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    mesh.apply_scale(shape.scale3())
    points, edges = mesh.vertices, mesh.vertices[mesh.edges_unique]
    low, high = mesh.bounds[:, 2]
    found = []
    for bottom, top in pairwise(np.linspace(low, high, n + 1)):
        inside = points[(points[:, 2] >= bottom) & (points[:, 2] <= top)]
        piece = np.concatenate([inside, _crossing(edges, bottom), _crossing(edges, top)])
        hull = trimesh.convex.convex_hull(piece)
        text = trimesh.exchange.obj.export_obj(hull, header=None, include_normals=False)
        found.append(Convex(InMemoryMesh(mesh_file=MemoryFile(text.encode(), ".obj", "slice"))))
    return found


def _crossing(edges: Array, height: float) -> Array:
    """Where edges (n, 2, 3) cross a height, shape (k, 3)."""
    over = edges[:, :, 2] - height
    a, b = edges[over[:, 0] * over[:, 1] < 0.0].swapaxes(0, 1)
    share = (height - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return np.asarray(a + share * (b - a))
