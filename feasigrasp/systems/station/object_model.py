"""Adds a `RigidObject` to a MultibodyPlant as a free body with its true shape."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    MakePhongIllustrationProperties,
    Mesh,
    PerceptionProperties,
    RenderLabel,
    Rgba,
    RoleAssign,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    CalcContactFrictionFromSurfaceProperties,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem

from feasigrasp.models.objects.distractor_bodies import DistractorBody
from feasigrasp.models.objects.mesh import obj_text
from feasigrasp.models.objects.rigid_object import RigidObject, write_mesh
from feasigrasp.outputs import write_text
from feasigrasp.scenario.schema import ObjectConfig
from feasigrasp.systems.ports import declare_output, scalar


class DistractorBodies(LeafSystem):
    """Poses of visible bodies without contact, in a scene graph.

    .. pydrake_system::

        name: DistractorBodies
        input_ports: [let_go, time]
        output_ports: [poses]

    ``let_go`` is V1, the time at which the carrier lets the object go [s], infinite before;
    ``poses`` is a ``FramePoseVector`` for the scene graph. ``time`` (V1) [s], optional, is when
    they are shown instead of now, such as the exposure of an image; NaN before it.
    """

    def __init__(self, bodies: Sequence[DistractorBody], frames: Sequence[FrameId]) -> None:
        super().__init__()
        self._bodies = list(zip(bodies, frames, strict=True))
        self._let_go = self.DeclareVectorInputPort("let_go", 1)
        self._time = self.DeclareVectorInputPort("time", 1)
        declare_output(self, "poses", self._calc, model=FramePoseVector())

    def _calc(self, context: Context) -> FramePoseVector:
        time = float(np.nan_to_num(scalar(self._time, context, context.get_time())))
        since = max(time - self._let_go.Eval(context)[0], 0.0)
        poses = FramePoseVector()
        for body, frame in self._bodies:
            poses.set_value(frame, RigidTransform(body.pose(time, since)))
        return poses


def add_distractor_bodies(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    bodies: Sequence[DistractorBody],
    *,
    name: str,
    directory: str | Path,
    first_label: int,
) -> DistractorBodies:
    """Puts bodies into a scene graph, and adds the system that moves them; its input is left open.

    They can be seen by cameras and viewers, and are no obstacle to anything. Their meshes are
    written to an existing folder, and read late by renderers. Their labels in label images count up
    from the first one.
    """
    source = scene_graph.RegisterSource(name)
    frames = []
    for label, body in enumerate(bodies, start=first_label):
        path = Path(directory) / f"{body.name}.obj"
        write_text(path, obj_text(body.mesh))
        frame = scene_graph.RegisterFrame(source, GeometryFrame(body.name))
        geometry = GeometryInstance(RigidTransform(), Mesh(str(path)), body.name)
        color = MakePhongIllustrationProperties(np.asarray(body.color))
        geometry.set_illustration_properties(color)
        seen = PerceptionProperties()
        seen.AddProperty("phong", "diffuse", Rgba(*body.color))
        seen.AddProperty("label", "id", RenderLabel(label))
        geometry.set_perception_properties(seen)
        scene_graph.RegisterGeometry(source, frame, geometry)
        frames.append(frame)
    moved = builder.AddNamedSystem(name, DistractorBodies(bodies, frames))
    builder.Connect(moved.get_output_port(), scene_graph.get_source_pose_port(source))
    return moved


# Friction between the gripper and what it holds.
#
# Drake combines the coefficients of two surfaces to ``2 a b / (a + b)``, which is the wanted one if
# both have it: so both are given it.


def set_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, instance: ModelInstanceIndex, friction: float
) -> None:
    """Gives all collision geometry of a model one Coulomb friction, static and dynamic."""
    inspector = scene_graph.model_inspector()
    both = CoulombFriction(friction, friction)
    for geometry in _surfaces(plant, instance):
        properties = inspector.GetProximityProperties(geometry)
        properties.UpdateProperty("material", "coulomb_friction", both)
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

    def frictions(instance: ModelInstanceIndex) -> list[CoulombFriction]:
        found = map(inspector.GetProximityProperties, _surfaces(plant, instance))
        return [each.GetProperty("material", "coulomb_friction") for each in found]

    pairs = itertools.product(frictions(one), frictions(other))
    contacts = (CalcContactFrictionFromSurfaceProperties(a, b) for a, b in pairs)
    return max(float(contact.static_friction()) for contact in contacts)


def _surfaces(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[GeometryId]:
    bodies = map(plant.get_body, plant.GetBodyIndices(instance))
    return [g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)]


def add_object(
    plant: MultibodyPlant,
    obj: RigidObject,
    *,
    directory: str | Path,
    friction: float = ObjectConfig.friction,
    model_name: str = "object",
) -> ModelInstanceIndex:
    """Adds the object as a free body named ``object`` in a model instance, and returns that.

    Its frame is the object frame O, with the origin at the centre of mass.

    The collision geometry is the triangle surface itself, with fewer faces, rigid hydroelastic and
    not declared convex, so a mug or a bowl stays hollow. (A compliant mesh, and any point contact,
    would be with the convex hull.) Contact therefore needs a compliant partner: the finger pads, a
    table with compliant hydroelastic properties. Two rigid surfaces fall back to point contact.

    Args:
        plant: A plant with a scene graph, before ``Finalize``.
        obj: The object.
        directory: Existing folder for ``<model_name>.obj`` and ``.urdf``, owned by the caller; it
            must outlive the diagram's first rendering (renderers read the mesh late).
        friction: Coulomb friction coefficient, static and dynamic.
        model_name: Name of the model instance and of the files.
    """
    directory = Path(directory)
    mesh = f"{model_name}.obj"
    collision_mesh = f"{model_name}_collision.obj"
    write_mesh(obj, directory / mesh)
    # The collision surface may differ this much from the visible one [m]: every face between the
    # pads is a contact of its own, so a surface with fewer faces makes a held object cheaper to
    # simulate.
    write_mesh(obj, directory / collision_mesh, tolerance=0.0005)
    urdf = directory / f"{model_name}.urdf"
    J, rgba = obj.inertia.tolist(), " ".join(f"{c:g}" for c in obj.color)
    urdf.write_text(f"""<?xml version="1.0"?>
<robot name="{model_name}" xmlns:drake="http://drake.mit.edu">
  <link name="object">
    <inertial>
      <mass value="{float(obj.mass)!r}"/>
      <inertia ixx="{J[0][0]!r}" iyy="{J[1][1]!r}" izz="{J[2][2]!r}"
               ixy="{J[0][1]!r}" ixz="{J[0][2]!r}" iyz="{J[1][2]!r}"/>
    </inertial>
    <visual>
      <geometry><mesh filename="{mesh}"/></geometry>
      <material name="{model_name}_color"><color rgba="{rgba}"/></material>
    </visual>
    <collision name="surface">
      <geometry><mesh filename="{collision_mesh}"/></geometry>
      <drake:proximity_properties>
        <drake:rigid_hydroelastic/>
        <drake:mu_static value="{float(friction)!r}"/>
        <drake:mu_dynamic value="{float(friction)!r}"/>
      </drake:proximity_properties>
    </collision>
  </link>
</robot>
""")
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    (instance,) = parser.AddModels(urdf)
    return instance
