"""Arms by name, and from YAML files."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from feasigrasp.errors import ArgumentError, ScenarioError
from feasigrasp.models.choices import nearest
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.arm import Arm, Capsule, DriverLimits, Family
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path

#: Keys of a joint that are numbers, and attributes of `Arm` that hold them.
_OF_JOINTS = {
    "lower": "lower",
    "upper": "upper",
    "velocity": "velocity_limits",
    "acceleration": "acceleration_limits",
    "effort": "effort_limits",
    "rotor_inertia": "rotor_inertias",
    "kp": "kp",
    "kd": "kd",
    "home": "home",
}


def arm_names() -> tuple[str, ...]:
    """Arms that come with the package."""
    return "iiwa7", *sorted(file.stem for file in model_path("arms").glob("*.yaml"))


@cache
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
        return arm_from(yaml.safe_load(file.read_text()))
    except KeyError as error:
        raise ScenarioError(f"{name}: there is no {error.args[0]}") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError, TypeError, ValueError) as error:
        raise ScenarioError(f"{name}: {error}") from error
    except ArgumentError as error:
        raise ScenarioError(f"{name}: {error}") from error


def arm_from(given: dict[str, Any]) -> Arm:
    """The arm that the content of a file describes."""
    joints, links, flange = given["joints"], given["links"], given["flange"]
    numbers = {
        attribute: np.array([float(joint[key]) for joint in joints])
        for key, attribute in _OF_JOINTS.items()
    }
    inertias = [(link["mass"], *link["com"], *link["inertia"]) for link in links]
    margin = np.deg2rad(1.0)
    return Arm(
        name=given["name"],
        points=np.array([joint["point"] for joint in joints], dtype=float),
        axes=np.array([joint["axis"] for joint in joints], dtype=float),
        X_WF=se3.make_pose(
            np.array(flange["axes"], dtype=float).T, np.array(flange["point"], dtype=float)
        ),
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
        family=Family[given["family"].upper()],
        inertias=np.array(inertias, dtype=float),
        **numbers,
    )
