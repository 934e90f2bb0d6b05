"""The URDF of the KUKA LBR iiwa 7 R800."""

from xml.etree import ElementTree as ET

import numpy as np

from feasigrasp.models.robot.iiwa import IIWA_7
from generator import urdf as xml

# Masses and inertias: CAD values scaled to KUKA's total mass of 23.9 kg, as published in the
# lbr_fri_ros2_stack (iiwa7_description.xacro); KUKA publishes no dynamic model. Per link: mass
# [kg]; centre of mass in the base frame at q = 0 [m]; Ixx, Iyy, Izz, Ixy, Ixz, Iyz about it with
# the base's axes [kg m^2]. Our link frames are aligned with the base at q = 0, so only heights
# have to be subtracted.
INERTIAS = (
    (4.855658, (-0.012857, 0.0, 0.069964), (0.017839, 0.022294, 0.021334, 0.0, 0.000781, 0.0)),
    (3.394011, (0.0, -0.034819, 0.270799), (0.021383, 0.020403, 0.007563, 0.0, 0.0, 0.003797)),
    (4.031991, (0.0, 0.029293, 0.426944), (0.031697, 0.030080, 0.009666, 0.0, 0.0, 0.005889)),
    (3.394011, (0.0, 0.034819, 0.670799), (0.021383, 0.020403, 0.007563, 0.0, 0.0, -0.003797)),
    (4.031989, (0.0, -0.029293, 0.826944), (0.031695, 0.030079, 0.009665, 0.0, 0.0, -0.005889)),
    (1.529239, (0.0, -0.029824, 1.023767), (0.008485, 0.007136, 0.003848, 0.0, 0.0, 0.002806)),
    (2.403626, (0.0, 0.000320, 1.144950), (0.007067, 0.006804, 0.004629, 0.0, 0.0, 0.000311)),
    (0.259474, (0.0, 0.0, 1.244782), (0.000171, 0.000171, 0.000299, 0.0, 0.0, 0.0)),
)
# Drake's estimates (models/iiwa_description/README.md, after Ott 2008) [kg m^2].
ROTOR_INERTIAS = (
    7.171875e-5,
    1.737109e-4,
    1.266406e-4,
    7.09765e-5,
    5.4375e-5,
    5.4765e-5,
    5.4375e-5,
)
GEAR_RATIO = 160.0
FRICTION = 0.6
RESOLUTION = 0.03


def _link(robot: ET.Element, index: int, height: float) -> None:
    link = ET.SubElement(robot, "link", name=IIWA_7.link_names[index])
    mass, com, inertia = INERTIAS[index]
    xml.inertial(link, mass, np.subtract(com, (0.0, 0.0, height)), inertia)
    xml.visual_mesh(link, xml.packaged_mesh(f"link_{index}.gltf"))
    own = [capsule for capsule in IIWA_7.capsules if capsule.body == index]
    for k, capsule in enumerate(own):
        a, b = np.array(capsule.a), np.array(capsule.b)
        x, y, z = b - a
        # Turns the capsule's z-axis to the segment (which has no x component or no y component).
        rpy = (np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z)), 0.0)
        size = {"radius": xml.number(capsule.radius), "length": xml.number(np.linalg.norm(b - a))}
        collision = xml.shape(
            link, "collision", size, name=f"capsule_{k}", tag="capsule", xyz=(a + b) / 2, rpy=rpy
        )
        xml.proximity(collision, friction=FRICTION, resolution=RESOLUTION)


def _joint(robot: ET.Element, i: int, step: float) -> None:
    joint = ET.SubElement(robot, "joint", name=IIWA_7.joint_names[i], type="revolute")
    ET.SubElement(joint, "parent", link=IIWA_7.link_names[i])
    ET.SubElement(joint, "child", link=IIWA_7.link_names[i + 1])
    xml.origin(joint, (0.0, 0.0, step))
    ET.SubElement(joint, "axis", xyz=xml.numbers(IIWA_7.axes[i]))
    limit = {
        "lower": -IIWA_7.upper[i],
        "upper": IIWA_7.upper[i],
        "velocity": IIWA_7.velocity_limits[i],
        "effort": IIWA_7.effort_limits[i],
        xml.drake_tag("acceleration"): IIWA_7.acceleration_limits[i],
    }
    ET.SubElement(joint, "limit", {k: repr(float(v)) for k, v in limit.items()})
    xml.actuator(robot, IIWA_7.joint_names[i], ROTOR_INERTIAS[i], GEAR_RATIO)


def arm_urdf() -> str:
    """Text of iiwa7.urdf: base frame ``iiwa_link_0``, tool frame ``iiwa_flange``."""
    robot = ET.Element("robot", name="iiwa7")
    links = IIWA_7.link_names
    for index, height in enumerate([0.0, *IIWA_7.points[:, 2].tolist()]):
        _link(robot, index, height)
    for i in range(IIWA_7.joints):
        _joint(robot, i, IIWA_7.link_steps[i])
    xml.frame(robot, "iiwa_flange", links[-1], (0.0, 0.0, IIWA_7.link_steps[-1]))
    for low, link in enumerate(links):
        others = range(low + 1, len(links))
        apart = [f"group_link_{high}" for high in others if (low, high) not in IIWA_7.pairs]
        xml.collision_filter(robot, f"group_link_{low}", [link], apart)
    return xml.document(robot)
