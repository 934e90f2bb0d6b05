"""Generated simulation model of an arm: its capsules are shown, and collide."""

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.robot.arm import Arm, Capsule

_ROBOT = """<?xml version="1.0"?>
<robot xmlns:drake="http://drake.mit.edu" name="{name}">
{links}{joints}  <frame name="{name}_flange" link="{last}" xyz="{xyz}" rpy="{rpy}" />
{filters}</robot>
"""
_LINK = """  <link name="{name}">
    <inertial>
      <origin xyz="{com}" rpy="0 0 0" />
      <mass value="{mass}" />
      <inertia ixx="{i[0]}" iyy="{i[1]}" izz="{i[2]}" ixy="{i[3]}" ixz="{i[4]}" iyz="{i[5]}" />
    </inertial>
{shapes}  </link>
"""
_SHAPE = """    <{kind} name="capsule_{k}">
      <origin xyz="{xyz}" rpy="{rpy}" />
      <geometry>
        <drake:capsule radius="{radius}" length="{length}" />
      </geometry>
{more}    </{kind}>
"""
_MATERIAL = """      <material name="shell">
        <color rgba="0.85 0.86 0.88 1" />
      </material>
"""
_CONTACT = """      <drake:proximity_properties>
        <drake:rigid_hydroelastic />
        <drake:mesh_resolution_hint value="0.03" />
        <drake:mu_static value="0.6" />
        <drake:mu_dynamic value="0.6" />
      </drake:proximity_properties>
"""
_JOINT = """  <joint name="{name}" type="revolute">
    <parent link="{parent}" />
    <child link="{child}" />
    <origin xyz="{xyz}" rpy="0 0 0" />
    <axis xyz="{axis}" />
    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}" \
drake:acceleration="{acceleration}" />
  </joint>
  <transmission name="{name}_transmission">
    <type>SimpleTransmission</type>
    <joint name="{name}" />
    <actuator name="{name}">
      <drake:rotor_inertia value="{rotor}" />
      <drake:gear_ratio value="1" />
    </actuator>
  </transmission>
"""
_FILTER = """  <drake:collision_filter_group name="group_{link}">
    <drake:member link="{link}" />
{ignored}  </drake:collision_filter_group>
"""


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in np.atleast_1d(values).astype(float))


def _shapes(k: int, capsule: Capsule) -> str:
    a, b = np.array(capsule.a), np.array(capsule.b)
    x, y, z = b - a
    # Turns the capsule's z-axis to the segment.
    rpy = (np.arctan2(-y, np.hypot(x, z)), np.arctan2(x, z), 0.0)
    values = {
        "k": k,
        "xyz": _numbers((a + b) / 2),
        "rpy": _numbers(rpy),
        "radius": _numbers(capsule.radius),
        "length": _numbers(np.linalg.norm(b - a)),
    }
    seen = _SHAPE.format(kind="visual", more=_MATERIAL, **values)
    return seen + _SHAPE.format(kind="collision", more=_CONTACT, **values)


def arm_urdf(arm: Arm) -> str:
    """Text of a URDF: base frame ``<name>_link_0``, tool frame ``<name>_flange``.

    Its link frames are those of `Arm`. Only the bodies of `Arm.pairs` collide with each other.
    """
    names, n, links, joints, filters = arm.link_names, arm.joints, "", "", ""
    for body, (name, row) in enumerate(zip(names, arm.inertias, strict=True)):
        own = [capsule for capsule in arm.capsules if capsule.body == body]
        links += _LINK.format(
            name=name,
            mass=_numbers(row[0]),
            com=_numbers(row[1:4]),
            i=[_numbers(value) for value in row[4:]],
            shapes="".join(_shapes(k, capsule) for k, capsule in enumerate(own)),
        )
        apart = [high for high in range(body + 1, n + 1) if (body, high) not in arm.pairs]
        ignored = "".join(
            f'    <drake:ignored_collision_filter_group name="group_{names[high]}" />\n'
            for high in apart
        )
        filters += _FILTER.format(link=name, ignored=ignored)
    steps = np.diff(arm.points, axis=0, prepend=np.zeros((1, 3)))
    for j, name in enumerate(arm.joint_names):
        joints += _JOINT.format(
            name=name,
            parent=names[j],
            child=names[j + 1],
            xyz=_numbers(steps[j]),
            axis=_numbers(arm.axes[j]),
            lower=_numbers(arm.lower[j]),
            upper=_numbers(arm.upper[j]),
            velocity=_numbers(arm.velocity_limits[j]),
            effort=_numbers(arm.effort_limits[j]),
            acceleration=_numbers(arm.acceleration_limits[j]),
            rotor=_numbers(arm.rotor_inertias[j]),
        )
    return _ROBOT.format(
        name=arm.name,
        links=links,
        joints=joints,
        last=names[-1],
        xyz=_numbers(arm.X_LF[:3, 3]),
        rpy=_numbers(_roll_pitch_yaw(arm.X_LF[:3, :3])),
        filters=filters,
    )


def _roll_pitch_yaw(R: ArrayLike) -> tuple[float, float, float]:
    R = np.asarray(R)
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])
