"""Generated simulation model of a hand: fingers with pads, or a suction cup on a stem."""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper, SuctionCup

#: Thickness of a finger's pad [m]. Source: guessed.
PAD_THICKNESS = 0.006

#: 0.34 kg is the mass of the SAKE EZGripper Dual, 0.05 kg that of its mount. Source: data sheet:
#: SAKE EZGripper Dual; the finger's share is guessed.
FINGER_MASS = 0.035
BODY_MASS = 0.34 + 0.05 - 2 * FINGER_MASS

SIDES = (("left", 1.0), ("right", -1.0))


#: Where the file of a mesh is, by its name.
Mesh = Callable[[str], str]


def _packaged(name: str) -> str:
    return f"package://feasigrasp/iiwa/meshes/{name}{'.vtk' if name == 'pad' else '.gltf'}"


def pad_size(gripper: ParallelGripper) -> Array:
    """Thickness, width and height of a pad [m]."""
    return np.array([PAD_THICKNESS, gripper.finger_width, 2 * gripper.tip])


def pad_vtk(gripper: ParallelGripper) -> str:
    """Text of pad.vtk: a box of 12 tetrahedra around its centre.

    Drake's own mesh of a box ends in a medial plate and has more tetrahedra, which doubles the
    polygons of every contact patch and with them the time of a simulation step.
    """
    corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * pad_size(gripper)
    points = np.concatenate([corners, np.zeros((1, 3))])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    # Seen from outside the sides run counter-clockwise, so (centre, a, b, c) has positive volume.
    cells = [(8, a, b, c) for q in sides for a, b, c in (q[:3], (q[0], *q[2:]))]
    lines = ["# vtk DataFile Version 3.0", "Pad, written by models/iiwa/make_models.py", "ASCII"]
    lines += ["DATASET UNSTRUCTURED_GRID", f"POINTS {len(points)} double"]
    lines += [_numbers(point) for point in points]
    lines += [f"CELLS {len(cells)} {5 * len(cells)}"]
    lines += ["4 " + " ".join(map(str, cell)) for cell in cells]
    lines += [f"CELL_TYPES {len(cells)}", *["10"] * len(cells)]
    return "\n".join(lines) + "\n"


_TRANSMISSION = """  <transmission name="left_finger_joint_transmission">
    <type>SimpleTransmission</type>
    <joint name="left_finger_joint" />
    <actuator name="left_finger_joint">
      <drake:rotor_inertia value="0" />
      <drake:gear_ratio value="1" />
    </actuator>
  </transmission>
"""
#: Angles of G in the flange frame [rad]. Source: layout.
_TURN = "0 0 1.570796327"


def _number(value: float) -> str:
    """Ten significant digits, without a negative zero."""
    return f"{float(value) + 0.0:.10g}"


def _numbers(values: ArrayLike) -> str:
    """Numbers joined by spaces."""
    return " ".join(map(_number, np.round(np.asarray(values, dtype=float), 12)))


def _collision(
    name: str, center: ArrayLike, geometry: str, modulus: float = 1e7, hint: str = ""
) -> str:
    """A compliant hydroelastic shape.

    All are: they make contact patches, not points, so a held object does not creep; one that is not
    would touch the convex hull of a rigid object, not its surface.
    """
    # Static and dynamic, of pads, fingers and palm. Source: guessed.
    friction = 0.8
    return f"""    <collision name="{name}">
      <origin xyz="{_numbers(center)}" rpy="0 0 0" />
      <geometry>
        <{geometry} />
      </geometry>
      <drake:proximity_properties>
        <drake:compliant_hydroelastic />
        <drake:hydroelastic_modulus value="{modulus:.0f}" />
{hint}        <drake:hunt_crossley_dissipation value="20" />
        <drake:mu_static value="{friction}" />
        <drake:mu_dynamic value="{friction}" />
      </drake:proximity_properties>
    </collision>
"""


def _box_size(size: ArrayLike) -> str:
    return f'box size="{_numbers(size)}"'


def _link(name: str, mass: float, center: Array, size: Array, mesh: str, collisions: str) -> str:
    """A solid box for its inertia."""
    x, y, z = np.square(size) * mass / 12
    ixx, iyy, izz = map(_number, (y + z, z + x, x + y))
    return f"""  <link name="{name}">
    <inertial>
      <origin xyz="{_numbers(center)}" rpy="0 0 0" />
      <mass value="{_number(mass)}" />
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0" />
    </inertial>
    <visual name="mesh">
      <origin xyz="0 0 0" rpy="0 0 0" />
      <geometry>
        <mesh filename="{mesh}" />
      </geometry>
    </visual>
{collisions}  </link>
"""


def _finger(side: str, sign: float, gripper: ParallelGripper, mesh: Mesh) -> str:
    """A finger; its frame has the axes of G and its origin on the face of the pad."""
    length = gripper.tip - gripper.heel
    size = np.array([gripper.finger_thickness, gripper.finger_width, length])
    center = np.array([sign * gripper.finger_thickness / 2, 0.0, gripper.tip - length / 2])
    pad_center = np.array([sign * PAD_THICKNESS / 2, 0.0, 0.0])
    pad = _collision("pad", pad_center, f'mesh filename="{mesh("pad")}"')
    bone_size = size - (PAD_THICKNESS, 0.002, 0.0)
    bone_center = center + (sign * PAD_THICKNESS / 2, 0.0, 0.0)
    bone = _collision("bone", bone_center, _box_size(bone_size))
    name = f"{side}_finger"
    return _link(name, FINGER_MASS, center, size, mesh(name), pad + bone)


def _joint(side: str, sign: float, gripper: ParallelGripper) -> str:
    """A prismatic joint whose position is half the gap; one motor, on the left, drives both."""
    mimic, force, speed = "", 2.0 * gripper.grip_force, 0.2  # of a finger [m/s]; guessed
    if side != "left":
        mimic, force = '    <mimic joint="left_finger_joint" multiplier="1" offset="0" />\n', 0.0
    return f"""  <joint name="{side}_finger_joint" type="prismatic">
    <parent link="gripper_body" />
    <child link="{side}_finger" />
    <origin xyz="{_numbers(gripper.X_FG[:3, 3])}" rpy="{_TURN}" />
    <axis xyz="{_number(sign)} 0 0" />
    <limit lower="0" upper="{_number(gripper.max_opening / 2)}" velocity="{speed}" \
effort="{_number(force)}" />
{mimic}  </joint>
"""


def gripper_urdf(gripper: ParallelGripper, mesh: Mesh = _packaged) -> str:
    """Text of gripper.urdf: base frame = the flange F, grasp frame ``grasp_frame``.

    Meshes by name are ``pad``, whose faces touch, and the visible ``gripper_body``,
    ``left_finger`` and ``right_finger``; those of the packaged cell unless given.

    Raises:
        GraspError: The fingers are no thicker than the pads on them.
    """
    if not gripper.finger_thickness > PAD_THICKNESS:
        raise GraspError(
            f"ParallelGripper.finger_thickness = {gripper.finger_thickness}: in simulation it has "
            f"to be more than that of the pad on it, {PAD_THICKNESS} m"
        )
    links = _body(gripper, BODY_MASS, mesh)
    links += "".join(_finger(*side, gripper, mesh) for side in SIDES)
    joints = "".join(_joint(*side, gripper) for side in SIDES)
    return _robot(gripper, links + joints + _TRANSMISSION, "left_finger", "right_finger")


def _robot(gripper: Gripper, parts: str, *fingers: str) -> str:
    members = "".join(
        f'    <drake:member link="{link}" />\n' for link in ("gripper_body", *fingers)
    )
    return f"""<?xml version="1.0"?>
<!-- Written by models/iiwa/make_models.py. -->
<robot xmlns:drake="http://drake.mit.edu" name="gripper">
{parts}  <frame name="grasp_frame" link="gripper_body" xyz="{_numbers(gripper.X_FG[:3, 3])}" \
rpy="{_TURN}" />
  <drake:collision_filter_group name="group_gripper">
{members}    <drake:ignored_collision_filter_group name="group_gripper" />
  </drake:collision_filter_group>
</robot>
"""


def _body(gripper: Gripper, mass: float, mesh: Mesh, more: str = "") -> str:
    """The link of the palm, and of what does not move in it."""
    palm_x, palm_y, palm_z = gripper.palm_size
    center = np.array([0.0, 0.0, gripper.tool_offset + gripper.heel - palm_z / 2])
    palm = np.array([palm_y, palm_x, palm_z])  # x_G is y_F
    collision = _collision("palm", center, _box_size(palm)) + more
    return _link("gripper_body", mass, center, palm, mesh("gripper_body"), collision)


def cup_urdf(cup: SuctionCup, mesh: Mesh) -> str:
    """Text of the URDF of a cup; its lip is so soft that it yields to what it is set down on."""
    # Pressure of the lip where it is pressed in by half its height [Pa]. Source: guessed.
    softness = 1e4
    # Length of the edges of a cylinder's mesh [m]. Source: numerical.
    hint = '        <drake:mesh_resolution_hint value="0.006" />\n'
    parts = ""
    for name, radius, low, high in _cup_parts(cup):
        middle = [0.0, 0.0, cup.tool_offset + (low + high) / 2]
        shape = f'cylinder radius="{_number(radius)}" length="{_number(high - low)}"'
        parts += _collision(name, middle, shape, softness if name == "lip" else 1e7, hint)
    return _robot(cup, _body(cup, BODY_MASS + 2 * FINGER_MASS, mesh, parts))


def _cup_parts(cup: SuctionCup) -> list[tuple[str, float, float, float]]:
    """Names, radii and ends in G of stem and lip."""
    back = -cup.height
    return [("stem", cup.stem_radius, cup.heel, back), ("lip", cup.radius, back, 0.0)]


def camera_pose(gripper: Gripper) -> Array:
    """Pose X_FC of ``camera_body`` in the flange frame.

    X_C = -x_G, Y_C = -y_G and Z_C = z_G, turned about X_C so that Z_C leans to the tool axis.
    """
    c, s = np.cos(gripper.camera_tilt), np.sin(gripper.camera_tilt)
    X_GC = np.eye(4)
    X_GC[:3, :3] = np.array([[-1, 0, 0], [0, -c, -s], [0, -s, c]])
    X_GC[:3, 3] = gripper.camera_center
    return gripper.X_FG @ X_GC


def hand_files(gripper: Gripper) -> dict[str, str]:
    """Texts of the files of a hand that has no packaged model, by name; all lie in one folder.

    Its visual geometry is its boxes, and the column between the flange and its palm.
    """
    # Side of the column that stands for the mount of another hand [m].
    column = 0.04

    def mesh(name: str) -> str:
        return f"{name}.vtk" if name == "pad" else f"{name}.obj"

    palm_x, palm_y, palm_z = gripper.palm_size
    back = gripper.tool_offset + gripper.heel - palm_z
    body = [_box([palm_y, palm_x, palm_z], [0.0, 0.0, back + palm_z / 2])]
    if back > 0.0:
        body.append(_box([column, column, back], [0.0, 0.0, back / 2]))
    if isinstance(gripper, SuctionCup):
        for _, radius, low, high in _cup_parts(gripper):
            part = trimesh.creation.cylinder(radius, high - low, sections=24)
            part.apply_translation([0.0, 0.0, gripper.tool_offset + (low + high) / 2])
            body.append(part)
        return {"gripper.urdf": cup_urdf(gripper, mesh), mesh("gripper_body"): _obj(body)}
    assert isinstance(gripper, ParallelGripper)
    files = {"gripper.urdf": gripper_urdf(gripper, mesh), mesh("pad"): pad_vtk(gripper)}
    files[mesh("gripper_body")] = _obj(body)
    length = gripper.tip - gripper.heel
    finger = [gripper.finger_thickness, gripper.finger_width, length]
    for side, sign in SIDES:
        middle = [sign * gripper.finger_thickness / 2, 0.0, gripper.tip - length / 2]
        files[mesh(f"{side}_finger")] = _obj([_box(finger, middle)])
    return files


def _box(size: ArrayLike, middle: ArrayLike) -> trimesh.Trimesh:
    box = trimesh.creation.box(size)
    box.apply_translation(middle)
    return box


def _obj(parts: list[trimesh.Trimesh]) -> str:
    mesh = sum(parts, trimesh.Trimesh())
    mesh.unmerge_vertices()  # so that every corner has the normal of its face
    text: str = trimesh.exchange.obj.export_obj(mesh, header=None, include_normals=True)
    return text
