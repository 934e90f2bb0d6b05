"""Puts a `RigidObject` into a MultibodyPlant as a free body with its true shape."""

from __future__ import annotations

from pathlib import Path

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from feasigrasp.models.objects.rigid_object import RigidObject, write_mesh
from feasigrasp.scenario.schema import ObjectConfig

_URDF = """<?xml version="1.0"?>
<robot name="{model_name}" xmlns:drake="http://drake.mit.edu">
  <link name="{body}">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{I[0][0]!r}" iyy="{I[1][1]!r}" izz="{I[2][2]!r}"
               ixy="{I[0][1]!r}" ixz="{I[0][2]!r}" iyz="{I[1][2]!r}"/>
    </inertial>
    <visual>
      <geometry><mesh filename="{mesh}"/></geometry>
      <material name="{model_name}_color"><color rgba="{rgba}"/></material>
    </visual>
    <collision name="surface">
      <geometry><mesh filename="{collision_mesh}"/></geometry>
      <drake:proximity_properties>
        <drake:rigid_hydroelastic/>
        <drake:mu_static value="{friction!r}"/>
        <drake:mu_dynamic value="{friction!r}"/>
      </drake:proximity_properties>
    </collision>
  </link>
</robot>
"""

#: The body's name in the plant; its frame is the object frame O (origin at the centre of mass).
BODY_NAME = "object"
#: The collision surface may differ this much from the visible one [m]: every face between the pads
#: is a contact of its own, so a surface with fewer faces makes a held object cheaper to simulate.
COLLISION_TOLERANCE = 0.0005


def add_object(
    plant: MultibodyPlant,
    obj: RigidObject,
    *,
    directory: str | Path,
    friction: float = ObjectConfig.friction,
    model_name: str = "object",
) -> ModelInstanceIndex:
    """Adds the object as a free body named ``object`` in its own model instance.

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

    Returns:
        The model instance.
    """
    directory = Path(directory)
    mesh = f"{model_name}.obj"
    collision_mesh = f"{model_name}_collision.obj"
    write_mesh(obj, directory / mesh)
    write_mesh(obj, directory / collision_mesh, tolerance=COLLISION_TOLERANCE)
    urdf = directory / f"{model_name}.urdf"
    urdf.write_text(
        _URDF.format(
            model_name=model_name,
            body=BODY_NAME,
            mass=float(obj.mass),
            I=obj.inertia.tolist(),
            mesh=mesh,
            collision_mesh=collision_mesh,
            rgba=" ".join(f"{c:g}" for c in obj.color),
            friction=float(friction),
        )
    )
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    (instance,) = parser.AddModels(urdf)
    return instance
