"""Arms by name, and from YAML files."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from feasigrasp.errors import ArgumentError, FeasigraspError, ScenarioError
from feasigrasp.inputs import read_yaml
from feasigrasp.models.arguments import check_of
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import nearest, parse_word
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import ArrayOf, Call, NotNegative, Positive, PositiveShare
from feasigrasp.models.robot.arm import Arm, Capsule, DriverLimits, Family
from feasigrasp.models.robot.capsules import HAND_NAMES
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path

_METERS = (10.0, " m: are these mm? Give metres")
_Vector = Annotated[Array, ArrayOf((3,), "m", most=_METERS)]
#: Keys of a joint: attributes of `Arm` that hold them, and what they may be.
_JOINT: dict[str, tuple[str, Any]] = {
    "point": ("points", _Vector),
    "axis": ("axes", _Vector),
    "lower": ("lower", float),
    "upper": ("upper", float),
    "velocity": ("velocity_limits", Positive),
    "acceleration": ("acceleration_limits", Positive),
    "effort": ("effort_limits", Positive),
    "rotor_inertia": ("rotor_inertias", NotNegative),
    "kp": ("kp", NotNegative),
    "kd": ("kd", NotNegative),
    "home": ("home", float),
}
_LINK = {
    "mass": Positive,
    "com": _Vector,
    "inertia": Annotated[Array, ArrayOf((6,), "kg m^2")],
    "capsules": [Annotated[Array, ArrayOf((7,), "m", most=_METERS)]],
}
_FILE = {
    "name": str,
    "family": str,
    "acceleration_share": PositiveShare,
    "position_margin": NotNegative,
    "joints": [{key: kind for key, (_, kind) in _JOINT.items()}],
    "links": [_LINK],
    "flange": {"point": _Vector, "axes": Annotated[Array, ArrayOf((3, 3), rotation=True)]},
    "pairs": [Annotated[Array, ArrayOf((2,), dtype=np.int64)]],
}


def arm_names() -> tuple[str, ...]:
    """Arms that come with the package."""
    return "iiwa7", *sorted(file.stem for file in model_path("arms").glob("*.yaml"))


def load_arm(name: str) -> Arm:
    """An arm by its name, or from a YAML file that ``feasigrasp arm`` writes.

    Raises:
        ScenarioError: There is no such arm or file, or it describes none.
    """
    if name == "iiwa7":
        return IIWA_7
    known = arm_names()
    file = model_path("arms", f"{name}.yaml") if name in known else Path(name)
    if not file.is_file():
        raise ScenarioError(
            f"arm is {name!r}, which is no file; give one, or one of {', '.join(known)}"
            f"{nearest(name, known)}"
        )
    try:
        return _described(file.read_text())
    except (OSError, UnicodeDecodeError, FeasigraspError) as error:
        raise ScenarioError(f"{name}: {error}") from error


@cache
def _described(text: str) -> Arm:
    return arm_from(read_yaml(text, ScenarioError))


def arm_from(given: dict[str, Any]) -> Arm:
    """The arm that the content of a file describes; raises FeasigraspError for none."""
    check: Any = check_of(_FILE)
    check(given, Call())
    joints, links, flange = given["joints"], given["links"], given["flange"]
    names = [family.name.lower() for family in Family]
    family = parse_word(names, given["family"].lower(), "family", ArgumentError)
    margin = np.deg2rad(1.0)
    wrong = next(_contradictions(given, max(margin, given["position_margin"])), None)
    if wrong is not None:
        raise ArgumentError(wrong)
    numbers = {
        attribute: np.array([joint[key] for joint in joints], dtype=float)
        for key, (attribute, _) in _JOINT.items()
    }
    inertias = [(link["mass"], *link["com"], *link["inertia"]) for link in links]
    return Arm(
        name=given["name"],
        X_WF=se3.make_pose(np.array(flange["axes"], dtype=float).T, flange["point"]),
        driver=DriverLimits(
            lower=numbers["lower"] + margin,
            upper=numbers["upper"] - margin,
            velocity=numbers["velocity_limits"],
            external_torque=numbers["effort_limits"],
        ),
        acceleration_share=float(given["acceleration_share"]),
        position_margin=float(given["position_margin"]),
        capsules=tuple(
            Capsule(body, (ax, ay, az), (bx, by, bz), radius)
            for body, link in enumerate(links)
            for ax, ay, az, bx, by, bz, radius in link["capsules"]
        ),
        pairs=tuple((int(low), int(high)) for low, high in given["pairs"]),
        family=Family[family.upper()],
        inertias=np.array(inertias, dtype=float),
        **numbers,
    )


def _contradictions(given: dict[str, Any], margin: float) -> Iterator[str]:
    """Contradictions between entries of a file; ``margin`` is from home to the limits [rad]."""
    joints, links, name = given["joints"], given["links"], given["name"]
    last, taken = len(joints) + len(HAND_NAMES), ("gripper", "camera", "table")
    if not re.fullmatch("[A-Za-z]\\w*", name, re.ASCII) or name in taken:
        yield f"name is {name!r}; give letters, digits and _, but none of {', '.join(taken)}"
    if (n := len(joints) + 1) != len(links):
        yield f"links has {len(links)} entries; give {n}, the base and one for each joint"
    for i, joint in enumerate(joints):
        lower, home, upper = joint["lower"], joint["home"], joint["upper"]
        if not lower + margin <= home <= upper - margin:
            yield (
                f"joints [{i}] has lower {lower:g}, home {home:g} and upper {upper:g}; give them "
                f"in this order, home {margin:.3g} rad off both"
            )
    for i, link in enumerate(links):
        xx, yy, zz, xy, xz, yz = link["inertia"]
        a, b, c = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if a < 0.0 or a + b < c - 1e-5:  # digits of files
            yield (
                f"links [{i}] inertia has the moments {a:g}, {b:g} and {c:g}; give Ixx, Iyy, Izz, "
                "Ixy, Ixz, Iyz with none negative, or above the sum of the others"
            )
        if not all(capsule[6] > 0.0 for capsule in link["capsules"]):
            yield f"links [{i}] capsules has a radius that is not positive; it is the last number"
    for i, (low, high) in enumerate(given["pairs"]):
        if not 0 <= low < high <= last:
            yield f"pairs [{i}] is {low}, {high}; give bodies from 0 to {last}, the lower first"
