"""An arm's description from a URDF, and what that leaves open: home, mounting, close pairs."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations, product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import trimesh
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import Rotation

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.arm import MEETING_TOLERANCE, Arm, meeting_point
from feasigrasp.models.robot.capsule_kernels import closest_parameters
from feasigrasp.models.robot.capsules import HAND_NAMES, capsule_model, hand_capsules
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability

#: Axes that are off a coordinate axis by less are along it: digits of model files [rad]. Source:
#: numerical.
_ALONG = 1e-4


@dataclass
class _Body:
    """What moves with one joint: masses, and vertices, in the base frame at q = 0."""

    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    vertices: list[Array] = field(default_factory=list)

    def add(self, X_WL: Array, link: ET.Element, folder: Path) -> None:
        """Takes in a link whose frame is at X_WL (4, 4)."""
        inertial = link.find("inertial")
        if inertial is not None:
            X_WI = X_WL @ _origin(inertial)
            mass, values = float(_value(inertial, "mass", "value")), inertial.find("inertia")
            assert values is not None
            if mass < 0.0:
                raise ArgumentError(f"link {link.get('name')}: its mass is {mass} kg")
            ixx, iyy, izz, ixy, ixz, iyz = (
                float(values.get(key, 0.0)) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
            )
            own = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
            R, p = X_WI[:3, :3], X_WI[:3, 3]
            self.mass += mass
            self.moment += mass * p
            self.inertia += R @ own @ R.T + mass * (p @ p * np.eye(3) - np.outer(p, p))
        for shape in link.findall("collision") or link.findall("visual"):
            mesh = _mesh(shape, folder)
            X_WS = X_WL @ _origin(shape)
            self.vertices.append(mesh.convex_hull.vertices @ X_WS[:3, :3].T + X_WS[:3, 3])


def _origin(element: ET.Element) -> Array:
    found = element.find("origin")
    values = {} if found is None else found.attrib
    x, y, z = (float(v) for v in values.get("xyz", "0 0 0").split())
    R = Rotation.from_euler("xyz", [float(v) for v in values.get("rpy", "0 0 0").split()])
    return se3.make_pose(R.as_matrix(), np.array([x, y, z]))


def _value(element: ET.Element, tag: str, key: str) -> str:
    found = element.find(tag)
    if found is None or key not in found.attrib:
        raise ArgumentError(f"<{element.tag} name={element.get('name')!r}> has no {tag} with {key}")
    return found.attrib[key]


def _mesh(shape: ET.Element, folder: Path) -> trimesh.Trimesh:
    geometry = shape.find("geometry")
    assert geometry is not None
    each = geometry[0]
    if each.tag == "mesh":
        path = _file(each.attrib["filename"], folder)
        try:
            mesh: trimesh.Trimesh = trimesh.load_mesh(path)
        except ImportError as error:  # COLLADA
            raise ArgumentError(f"{path}: {error}; or convert it to STL") from error
        mesh.apply_scale([float(v) for v in each.get("scale", "1 1 1").split()])
        return mesh
    if each.tag == "box":
        return trimesh.creation.box([float(v) for v in each.attrib["size"].split()])
    radius, length = float(each.attrib["radius"]), float(each.get("length", 0.0))
    if each.tag == "sphere":
        return trimesh.creation.icosphere(radius=radius)
    if each.tag == "cylinder":
        return trimesh.creation.cylinder(radius, length)
    return trimesh.creation.capsule(length, radius)


def _file(name: str, folder: Path) -> Path:
    """A mesh by its name in a URDF; of packages the folders above the URDF are looked through."""
    path = name.removeprefix("file://").removeprefix("package://")
    tails = [Path(*Path(path).parts[k:]) for k in (0, 1)]
    for place in (folder, *folder.parents):
        for tail in tails:
            if (place / tail).is_file():
                return place / tail
    raise ArgumentError(f"there is no {name} in or above {folder}")


def _snapped(X: Array) -> Array:
    """A pose whose rotation has its axes along coordinate axes, if it nearly has."""
    R = np.round(X[:3, :3])
    if np.abs(R - X[:3, :3]).max() > _ALONG:
        return X
    return se3.make_pose(R, X[:3, 3])


def describe_urdf(file: Path, flange: str) -> dict[str, Any]:
    """What the file of an arm holds (`feasigrasp.models.robot.arm_file`), but for what is chosen.

    Gains, rotor inertias, home and pairs are left to `feasigrasp.commands.arm`.

    Raises:
        ArgumentError: The file is no URDF of an arm with such a flange.
    """
    try:
        return _described(ET.parse(file).getroot(), file, flange)
    except ArgumentError:
        raise
    except (OSError, ET.ParseError, ValueError, KeyError, AssertionError) as error:
        what = f"{type(error).__name__}: {error}"
        raise ArgumentError(f"{file} is no URDF ({what}); of a xacro, expand it first") from error


def _described(robot: ET.Element, file: Path, flange: str) -> dict[str, Any]:
    links = {link.get("name", ""): link for link in robot.findall("link")}
    above = {_value(joint, "child", "link"): joint for joint in robot.findall("joint")}
    if flange not in links:
        raise ArgumentError(f"{file} has no link {flange!r}; it has {', '.join(links)}")
    path, link = [], flange
    while link in above:
        if above[link] in path:
            raise ArgumentError(f"{file}: the joints from {flange} to the base go in a circle")
        path.append(above[link])
        link = _value(above[link], "parent", "link")
    moving = [joint for joint in reversed(path) if joint.get("type") != "fixed"]
    X_of, number = {link: np.eye(4)}, {link: 0}  # that is the base now
    joints: list[dict[str, Any]] = []
    for joint in reversed(path):
        parent, child = _value(joint, "parent", "link"), _value(joint, "child", "link")
        X_of[child] = _snapped(X_of[parent] @ _origin(joint))
        number[child] = number[parent] + (joint in moving)
        if joint in moving:
            joints.append(_joint(joint, X_of[child]))
    # No arm is longer [m].
    if (far := float(np.linalg.norm(X_of[flange][:3, 3]))) > 10.0:
        raise ArgumentError(f"{file}: {flange} is {far:.0f} m off the base; are these mm?")
    bodies = [_Body() for _ in range(len(joints) + 1)]
    for name, X_WL, body in _rigid(robot, X_of, number, flange):
        bodies[body].add(X_WL, links[name], file.parent)
    if not any(body.vertices for body in bodies):
        raise ArgumentError(f"{file}: no link has geometry, and nothing would be kept clear of")
    origins = [np.zeros(3), *(np.array(joint["point"]) for joint in joints)]
    return {
        "family": _family(joints),
        "acceleration_share": 0.94,
        "position_margin": 0.03,
        "joints": joints,
        "X_WF": X_of[flange],
        "links": [_link(b, p) for b, p in zip(bodies, origins, strict=True)],
    }


def _rigid(
    robot: ET.Element, X_of: dict[str, Array], number: dict[str, int], flange: str
) -> Iterator[tuple[str, Array, int]]:
    """Links with their poses and bodies: those of the path, and what is fixed to them.

    What is fixed to the flange is a hand, and none of the arm.
    """
    todo = list(number)
    while todo:
        name = todo.pop()
        yield name, X_of[name], number[name]
        for joint in robot.findall("joint"):
            child = _value(joint, "child", "link")
            known = child in number or joint.get("type") != "fixed" or name == flange
            if _value(joint, "parent", "link") == name and not known:
                X_of[child], number[child] = X_of[name] @ _origin(joint), number[name]
                todo.append(child)


def _joint(joint: ET.Element, X_WL: Array) -> dict[str, Any]:
    name, axis = joint.get("name"), joint.find("axis")
    if joint.get("type") not in ("revolute", "continuous"):
        raise ArgumentError(f"{name} is {joint.get('type')}; joints of an arm turn")
    own = [1.0, 0.0, 0.0] if axis is None else [float(v) for v in axis.attrib["xyz"].split()]
    if not np.linalg.norm(own) > 0.0:
        raise ArgumentError(f"joint {name}: its axis is {own}")
    direction = X_WL[:3, :3] @ np.array(own) / np.linalg.norm(own)
    if np.abs(direction - np.round(direction)).max() < _ALONG:
        direction = np.round(direction)
    limit = joint.find("limit")
    values = {} if limit is None else limit.attrib
    turn = 2.0 * np.pi if joint.get("type") == "continuous" else 0.0
    velocity, effort = float(values.get("velocity", np.pi)), float(values.get("effort", 100.0))
    lower, upper = float(values.get("lower", -turn)), float(values.get("upper", turn))
    # No joint turns by less [rad], or by more than two turns.
    if not (upper - lower > 0.2 and max(-lower, upper) <= 4.0 * np.pi):
        raise ArgumentError(f"joint {name}: its limits are {lower} and {upper}; give radians")
    if not (velocity > 0.0 and effort > 0.0):
        raise ArgumentError(f"joint {name}: velocity and effort must be positive")
    return {
        "point": [_plain(v) for v in X_WL[:3, 3]],
        "axis": [float(v) + 0.0 for v in direction],
        "lower": lower,
        "upper": upper,
        "velocity": velocity,
        "acceleration": _plain(velocity / 0.3, 4),  # it reaches its speed limit in 0.3 s; guessed
        "effort": effort,
    }


def _plain(value: float, digits: int = 6) -> float:
    return round(float(value), digits) + 0.0


def _family(joints: list[dict[str, Any]]) -> str:
    """The build of an arm, by the residuals of its axes."""
    h = np.array([joint["axis"] for joint in joints], dtype=float)
    p = np.array([joint["point"] for joint in joints])

    def meet(*which: int) -> bool:
        return meeting_point(h[[*which]], p[[*which]])[1] < MEETING_TOLERANCE

    def parallel(*which: int) -> bool:
        return bool(np.abs(np.cross(h[[*which]], h[which[0]])).max() < MEETING_TOLERANCE)

    wrist = len(joints) > 5 and not parallel(4, 5) and meet(4, 5)
    if len(joints) == 7 and wrist and meet(0, 1, 2):
        return "shoulder_wrist"
    if len(joints) == 6 and wrist and parallel(1, 2, 3):
        return "parallel"
    return "seeded"


def _link(body: _Body, origin: Array) -> dict[str, Any]:
    com = body.moment / body.mass if body.mass > 0.0 else origin
    inertia = body.inertia - body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    mass = max(body.mass, 0.1)
    least = 1e-4 * mass  # a model without inertias
    inertia = inertia + max(0.0, least - np.linalg.eigvalsh(inertia)[0]) * np.eye(3)
    # Drake refuses a largest moment of inertia above the sum of the others.
    a, b, c = np.linalg.eigvalsh(inertia)
    inertia = inertia + max(0.0, c - a - b + 1e-6) * np.eye(3)
    entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    points = np.concatenate(body.vertices) - origin if body.vertices else np.zeros((0, 3))
    return {
        "mass": _plain(mass),
        "com": [_plain(v) for v in com - origin],
        "inertia": [_plain(v) for v in entries],
        "capsules": [fitted_capsule(points)] if len(points) else [],
    }


def fitted_capsule(points: Array) -> list[float]:
    """The capsule of least volume that holds points (n, 3): both ends, then the radius [m].

    Nelder and Mead's method from the three principal axes. Lengths are rounded to millimetres, the
    radius up.
    """

    def radius(ends: Array) -> float:
        a, b = ends[:3], ends[3:]
        square = max(float((b - a) @ (b - a)), 1e-18)
        t = np.clip((points - a) @ (b - a) / square, 0.0, 1.0)
        return float(np.linalg.norm(points - a - t[:, None] * (b - a), axis=1).max())

    def volume(ends: Array) -> float:
        r = radius(ends)
        return np.pi * r**2 * (float(np.linalg.norm(ends[3:] - ends[:3])) + 4.0 / 3.0 * r)

    middle = 0.5 * (points.max(0) + points.min(0))
    axes = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    found = []
    for axis in axes:
        half = 0.5 * np.ptp(points @ axis) * axis
        start = np.concatenate([middle - 0.5 * half, middle + 0.5 * half])
        found.append(minimize(volume, start, method="Nelder-Mead", options={"maxiter": 4000}))
    ends = np.round(min(found, key=lambda each: each.fun).x, 3)
    return [*(float(v) + 0.0 for v in ends), float(np.ceil(1e3 * radius(ends)) / 1e3)]


#: Bodies that touch in a larger share of configurations are taken to be built so; those that never
#: come nearer than the second need no check [m]. Source: guessed.
_BUILT_SO, _NEVER_NEAR = 0.2, 0.02
#: Of the hand at home: place on an arm of 0.9 m [m], and approach direction. Source: guessed.
_HOME, _APPROACH, _REACH = np.array([0.22, 0.0, 0.73]), np.array([0.82, 0.0, -0.57]), 0.9


def chosen_home(arm: Arm) -> Array:
    """The most manipulable configuration found with the hand in front of the arm, shape (n,).

    Where the wrist cannot be so near the first axis, the hand is farther out.
    """
    X_FG, n = ParallelGripper().X_FG, arm.joints
    lower, upper = arm.turns[0] + 0.2, arm.turns[1] - 0.2
    middle, starts = 0.5 * (lower + upper), np.random.default_rng(0).uniform(size=(40, n))
    for out in (0.0, 0.08, 0.16):
        place = (_HOME + [out, 0.0, 0.5 * out]) * min(1.0, arm.reach / _REACH)

        def error(q: Array, place: Array = place) -> Array:
            X_WG = forward_kinematics(q, X_FG, arm)
            way, turn = X_WG[:3, 3] - place, 0.5 * (X_WG[:3, 2] - _APPROACH)
            return np.concatenate([way, turn, 1e-3 * (q - middle), 1e-2 * q[:1]])

        found = []
        for start in lower + starts * (upper - lower):
            q = least_squares(error, start, bounds=(lower, upper)).x
            room = float(np.min(np.minimum(q - lower, upper - q)))
            if np.abs(error(q)[:6]).max() < 0.03:
                worth = float(manipulability(q, arm)) * min(1.0, room / 0.3) - abs(q[0])
                found.append((worth, q.tolist()))
        if found:
            return np.array(max(found)[1])
    return middle


def camera_above(arm: Arm) -> Array:
    """The flange frame (4, 4) at q = 0, turned about its z-axis so that the camera is above."""
    R = forward_kinematics(arm.home, None, arm)[:3, :3]
    down = np.array([0.0, 0.0, -1.0]) - 0.1 * np.array([1.0, 0.0, 0.0])
    angle = float(np.arctan2(R[:, 1] @ down, R[:, 0] @ down))
    quarter = np.pi / 4.0  # mounts have holes at such angles
    c, s = np.cos(round(angle / quarter) * quarter), np.sin(round(angle / quarter) * quarter)
    X_WF = arm.X_WF.copy()
    X_WF[:3, :3] = X_WF[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return X_WF


def close_pairs(arm: Arm) -> list[tuple[int, int]]:
    """Pairs of bodies that come close, of 1,000 configurations, and do not touch in most."""
    n = arm.joints
    hand = range(n + 1, n + 1 + len(HAND_NAMES))
    # No joint connects them, nor two with a link between them.
    apart = [(a, b) for a, b in combinations(range(n + 1), 2) if b - a > 2]
    possible = [*apart, *product(range(n - 1), hand)]
    model = capsule_model(None, arm, body_pairs=possible)
    bodies = [capsule.body for capsule in arm.capsules + hand_capsules(None, arm)]
    Q = arm.random_positions(np.random.default_rng(0), 1000)
    gaps: dict[tuple[int, int], list[float]] = {pair: [] for pair in possible}
    for q in Q:
        points = [tuple(map(tuple, pair)) for pair in model.placed(q).tolist()]
        close: dict[tuple[int, int], float] = {}
        for i, j in model.pairs.tolist():
            d = closest_parameters(*points[i], *points[j])[2]
            pair = bodies[i], bodies[j]
            gap = float(np.linalg.norm(d)) - model.radius[i] - model.radius[j]
            close[pair] = min(gap, close.get(pair, np.inf))
        for pair, gap in close.items():
            gaps[pair].append(gap)
    return [
        pair
        for pair, found in gaps.items()
        if min(found, default=np.inf) < _NEVER_NEAR
        and sum(gap < 0.0 for gap in found) < _BUILT_SO * len(Q)
    ]
