"""Snippets of URDF for generated models: numbers, origins, inertias, boxes, cylinders, capsules."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

DRAKE = "http://drake.mit.edu"
ET.register_namespace("drake", DRAKE)


def number(value: float) -> str:
    """Ten significant digits, without a negative zero."""
    return f"{float(value) + 0.0:.10g}"


def numbers(values: ArrayLike) -> str:
    """Numbers joined by spaces."""
    rounded = np.round(np.asarray(values, dtype=float).ravel(), 12) + 0.0
    return " ".join(number(v) for v in rounded)


def drake_tag(name: str) -> str:
    """Name of an element of Drake's own namespace."""
    return f"{{{DRAKE}}}{name}"


def origin(parent: ET.Element, xyz: ArrayLike = (0, 0, 0), rpy: ArrayLike = (0, 0, 0)) -> None:
    """Adds ``<origin>``; roll, pitch and yaw in rad."""
    ET.SubElement(parent, "origin", xyz=numbers(xyz), rpy=numbers(rpy))


def inertial(link: ET.Element, mass: float, com: ArrayLike, inertia: Sequence[float]) -> None:
    """Adds ``<inertial>``; inertia about the centre of mass: Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    element = ET.SubElement(link, "inertial")
    origin(element, com)
    ET.SubElement(element, "mass", value=number(mass))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    ET.SubElement(element, "inertia", {n: number(v) for n, v in zip(names, inertia, strict=True)})


def box_inertia(mass: float, size: ArrayLike) -> list[float]:
    """Inertia of a solid box about its centre, in the order that `inertial` takes."""
    x, y, z = np.square(np.asarray(size, dtype=float)) * mass / 12
    return [y + z, x + z, x + y, 0.0, 0.0, 0.0]


def shape(
    link: ET.Element,
    kind: str,
    geometry: dict[str, str],
    *,
    name: str,
    tag: str = "box",
    xyz: ArrayLike = (0, 0, 0),
    rpy: ArrayLike = (0, 0, 0),
) -> ET.Element:
    """Adds a ``<visual>`` or ``<collision>`` (``kind``) with one geometry element ``tag``."""
    element = ET.SubElement(link, kind, name=name)
    origin(element, xyz, rpy)
    ET.SubElement(ET.SubElement(element, "geometry"), tag, geometry)
    return element


def packaged_mesh(name: str) -> str:
    """Path of the file ``name`` among the meshes of the packaged cell."""
    return f"package://feasigrasp/iiwa/meshes/{name}"


def visual_mesh(link: ET.Element, uri: str) -> None:
    """Adds a ``<visual>`` that shows a mesh file."""
    shape(link, "visual", {"filename": uri}, name="mesh", tag="mesh")


def frame(
    robot: ET.Element, name: str, link: str, xyz: ArrayLike, rpy: ArrayLike = (0, 0, 0)
) -> None:
    """Adds a frame fixed to a link (Drake's extension of URDF)."""
    ET.SubElement(robot, "frame", name=name, link=link, xyz=numbers(xyz), rpy=numbers(rpy))


def actuator(
    robot: ET.Element, joint: str, rotor_inertia: float = 0.0, gear_ratio: float = 1.0
) -> None:
    """Adds a transmission with an actuator that has the joint's name."""
    transmission = ET.SubElement(robot, "transmission", name=f"{joint}_transmission")
    ET.SubElement(transmission, "type").text = "SimpleTransmission"
    ET.SubElement(transmission, "joint", name=joint)
    element = ET.SubElement(transmission, "actuator", name=joint)
    ET.SubElement(element, drake_tag("rotor_inertia"), value=number(rotor_inertia))
    ET.SubElement(element, drake_tag("gear_ratio"), value=number(gear_ratio))


def box(size: ArrayLike) -> dict[str, str]:
    """Attributes of a ``<box>``."""
    return {"size": numbers(size)}


def proximity(
    collision: ET.Element,
    *,
    friction: float,
    resolution: float | None = None,
) -> None:
    """Adds contact properties; every shape is compliant hydroelastic.

    A shape that is not would touch the convex hull of a rigid object, not its surface. ``friction``
    is static and dynamic; ``resolution`` is how finely a round shape is meshed [m].
    """
    # Of all surfaces: they make contact patches instead of points, so a held object does not creep.
    modulus = 1e7
    dissipation = 20.0
    element = ET.SubElement(collision, drake_tag("proximity_properties"))
    ET.SubElement(element, drake_tag("compliant_hydroelastic"))
    ET.SubElement(element, drake_tag("hydroelastic_modulus"), value=number(modulus))
    if resolution is not None:
        ET.SubElement(element, drake_tag("mesh_resolution_hint"), value=number(resolution))
    ET.SubElement(element, drake_tag("hunt_crossley_dissipation"), value=number(dissipation))
    ET.SubElement(element, drake_tag("mu_static"), value=number(friction))
    ET.SubElement(element, drake_tag("mu_dynamic"), value=number(friction))


def collision_filter(robot: ET.Element, name: str, members: list[str], ignored: list[str]) -> None:
    """Adds a collision filter group whose members ignore the members of the groups ``ignored``."""
    group = ET.SubElement(robot, drake_tag("collision_filter_group"), name=name)
    for link in members:
        ET.SubElement(group, drake_tag("member"), link=link)
    for other in ignored:
        ET.SubElement(group, drake_tag("ignored_collision_filter_group"), name=other)


def document(robot: ET.Element) -> str:
    """The XML text, indented, with a comment on its generator."""
    ET.indent(robot)
    body = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- Written by models/iiwa/make_models.py. -->\n{body}\n'
