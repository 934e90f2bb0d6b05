"""Generated simulation model of an arm: its capsules are shown, and collide."""

import numpy as np
from numpy.typing import ArrayLike
from trimesh.transformations import euler_from_matrix

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm, Capsule

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


def arm_urdf(arm: Arm) -> str:
    """Text of a URDF: base frame ``<name>_link_0``, tool frame ``<name>_flange``.

    Its link frames are those of `Arm`. Only the bodies of `Arm.pairs` collide with each other.
    """
    bodies = range(arm.joints + 1)
    steps = np.diff(arm.points, axis=0, prepend=np.zeros((1, 3)))
    links = "".join(_link(arm, body) for body in bodies)
    joints = "".join(_joint(arm, j, step) for j, step in enumerate(steps))
    filters = "".join(_collision_filter(arm, body) for body in bodies)
    rpy = _numbers(euler_from_matrix(arm.X_LF))
    return f"""<?xml version="1.0"?>
<robot xmlns:drake="http://drake.mit.edu" name="{arm.name}">
{links}{joints}  <frame name="{arm.name}_flange" link="{arm.link_names[-1]}" \
xyz="{_numbers(arm.X_LF[:3, 3])}" rpy="{rpy}" />
{filters}</robot>
"""


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in np.atleast_1d(values).astype(float))


def _link(arm: Arm, body: int) -> str:
    mass, x, y, z, *moments = arm.inertias[body]
    ixx, iyy, izz, ixy, ixz, iyz = map(_numbers, moments)
    own = [capsule for capsule in arm.capsules if capsule.body == body]
    shapes = "".join(_shapes(k, capsule) for k, capsule in enumerate(own))
    return f"""  <link name="{arm.link_names[body]}">
    <inertial>
      <origin xyz="{_numbers([x, y, z])}" rpy="0 0 0" />
      <mass value="{_numbers(mass)}" />
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}" />
    </inertial>
{shapes}  </link>
"""


def _shapes(k: int, capsule: Capsule) -> str:
    a, b = np.array(capsule.a), np.array(capsule.b)
    x, y, z = b - a
    # Turns the capsule's z-axis to the segment.
    rpy = _numbers([np.arctan2(-y, np.hypot(x, z)), np.arctan2(x, z), 0.0])
    length = _numbers(np.linalg.norm(b - a))
    return "".join(
        f"""    <{kind} name="capsule_{k}">
      <origin xyz="{_numbers((a + b) / 2)}" rpy="{rpy}" />
      <geometry>
        <drake:capsule radius="{_numbers(capsule.radius)}" length="{length}" />
      </geometry>
{more}    </{kind}>
"""
        for kind, more in (("visual", _MATERIAL), ("collision", _CONTACT))
    )


def _joint(arm: Arm, j: int, step: Array) -> str:
    """Joint j with its motor; its link is a ``step`` (3,) [m] from the one before."""
    name, limits = arm.joint_names[j], (arm.lower, arm.upper, arm.velocity_limits)
    lower, upper, velocity, effort, acceleration, rotor = (
        _numbers(each[j])
        for each in (*limits, arm.effort_limits, arm.acceleration_limits, arm.rotor_inertias)
    )
    return f"""  <joint name="{name}" type="revolute">
    <parent link="{arm.link_names[j]}" />
    <child link="{arm.link_names[j + 1]}" />
    <origin xyz="{_numbers(step)}" rpy="0 0 0" />
    <axis xyz="{_numbers(arm.axes[j])}" />
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


def _collision_filter(arm: Arm, body: int) -> str:
    names = arm.link_names
    ignored = "".join(
        f'    <drake:ignored_collision_filter_group name="group_{names[high]}" />\n'
        for high in range(body + 1, len(names))
        if (body, high) not in arm.pairs
    )
    return f"""  <drake:collision_filter_group name="group_{names[body]}">
    <drake:member link="{names[body]}" />
{ignored}  </drake:collision_filter_group>
"""
