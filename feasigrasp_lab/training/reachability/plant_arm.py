"""Extracts a serial arm from a Drake plant: joint chain and self-collisions.

Any model that Drake's parser reads will do: a model directives file, URDF, SDFormat or MJCF.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common import Parallelism
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, PrismaticJoint, RevoluteJoint
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.resources import model_path


@dataclass(frozen=True, eq=False)
class SerialChain(Frozen):
    """A chain of n joints from a base frame to an end frame.

    Attributes:
        X_PJ: Frame of each joint at position 0 in the frame that the joint before it moves (in the
            base frame for the first), shape (n, 4, 4) [m].
        axes: Unit axes in these frames, shape (n, 3).
        prismatic: Whether a joint slides along its axis instead of turning about it, shape (n,).
        X_JE: End frame in the frame that the last joint moves, shape (4, 4) [m].
        lower: Lower limits, shape (n,) [rad or m].
        upper: Upper limits, shape (n,) [rad or m].

    Raises:
        ReachabilityError: A joint has no finite limits.
    """

    X_PJ: Array
    axes: Array
    prismatic: Mask
    X_JE: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        """Freezes the arrays and checks the limits."""
        self._freeze(**{name: np.array(array) for name, array in vars(self).items()})
        bad = np.flatnonzero(~(np.isfinite(self.lower - self.upper) & (self.lower <= self.upper)))
        if len(bad):
            raise ReachabilityError(
                f"SerialChain: joint {bad[0]} has limits {self.lower[bad[0]]} ... "
                f"{self.upper[bad[0]]}; sampling needs finite ones, set them in the model file."
            )

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """Poses of the end frame in the base frame, shape (..., 4, 4), of positions (..., n)."""
        return self.pose_and_jacobian(q)[0]

    def manipulability(self, q: ArrayLike) -> Array:
        """Yoshikawa's measure sqrt(det J J^T), shape (...); 0 with fewer than six joints."""
        J = self.pose_and_jacobian(q)[1]
        return np.asarray(np.sqrt(np.maximum(np.linalg.det(J @ J.swapaxes(-1, -2)), 0.0)))

    def pose_and_jacobian(self, q: ArrayLike) -> tuple[Array, Array]:
        """Pose and geometric Jacobian of the end frame in the base frame.

        Args:
            q: Joint positions, shape (..., n) [rad or m].

        Returns:
            Poses, shape (..., 4, 4) [m], and Jacobians, shape (..., 6, n), with rows
            [angular; linear] at the end frame's origin.
        """
        q, sliding = np.asarray(q, dtype=float), self.prismatic[:, None]
        screws = np.concatenate([self.axes * ~sliding, self.axes * sliding], axis=1)
        X = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
        axes, points = np.empty((2, *q.shape, 3))
        for k in range(len(self.axes)):
            X = X @ self.X_PJ[k]
            axes[..., k, :], points[..., k, :] = X[..., :3, :3] @ self.axes[k], X[..., :3, 3]
            X = X @ se3.exp(q[..., k, None] * screws[k])
        X = X @ self.X_JE
        lever = X[..., None, :3, 3] - points
        J = np.concatenate(
            [np.where(sliding, 0.0, axes), np.where(sliding, axes, np.cross(axes, lever))], axis=-1
        )
        return X, J.swapaxes(-1, -2)


class PlantArm:
    """An arm of a model file, ready for `feasigrasp_lab.training.reachability.reachable_poses`.

    Joints that are not between the two frames (fingers, say) stay at their default positions, and
    whatever geometry the file has counts in collisions, minus what Drake filters (neighbours, and
    the collision filter groups of the file).
    """

    def __init__(self, filename: str | Path, base_frame: str, end_frame: str) -> None:
        """Loads a file.

        Args:
            filename: ``.dmd.yaml``, ``.urdf``, ``.sdf`` or ``.xml``.
            base_frame: Name of the frame that poses are expressed in; fixed to the world if the
                file leaves it free. ``model::frame`` where the name alone is ambiguous.
            end_frame: Name of the frame whose poses are wanted.

        Raises:
            ReachabilityError: The file or a frame is missing, or there is no serial chain of
                revolute and prismatic joints from one frame to the other.
        """
        builder = RobotDiagramBuilder(time_step=0.0)
        _parse(builder.parser(), builder.plant(), Path(filename))
        plant = builder.plant()
        base, end = _frame(plant, base_frame), _frame(plant, end_frame)
        _anchor(plant, base)
        plant.Finalize()
        joints = _joints_between(plant, base, end)
        moving = [joint for joint in joints if joint.num_positions() > 0]
        self.chain = _chain(base, end, joints)
        self.lower, self.upper = self.chain.lower, self.chain.upper
        self.forward_kinematics = self.chain.forward_kinematics
        self.manipulability = self.chain.manipulability
        self._indices = np.array([joint.position_start() for joint in moving])
        self._default = plant.GetDefaultPositions()
        robots = {joint.child_body().model_instance() for joint in moving}
        self._checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=sorted(robots, key=int), edge_step_size=0.1
        )

    def in_collision(self, q: ArrayLike) -> Mask:
        """Which configurations (m, n) are in collision, shape (m,)."""
        q = np.asarray(q, dtype=float)
        full = np.tile(self._default, (len(q), 1))
        full[:, self._indices] = q
        free = self._checker.CheckConfigsCollisionFree(list(full), parallelize=Parallelism.Max())
        return np.asarray(free) == 0


def _parse(parser: Parser, plant: MultibodyPlant, filename: Path) -> None:
    if not filename.is_file():
        raise ReachabilityError(f"{filename}: no such file; give a model directives file or model.")
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    try:
        if filename.suffix == ".yaml":
            ProcessModelDirectives(LoadModelDirectives(str(filename)), plant, parser)
        else:
            parser.AddModels(str(filename))
    except RuntimeError as error:
        raise ReachabilityError(f"Drake cannot read {filename}: {error}") from error


def _frame(plant: MultibodyPlant, name: str) -> Frame:
    model, _, local = name.rpartition("::")
    try:
        if model:
            return plant.GetFrameByName(local, plant.GetModelInstanceByName(model))
        return plant.GetFrameByName(local)
    except RuntimeError as error:
        raise ReachabilityError(f"no frame {name!r}: {error}") from error


def _anchor(plant: MultibodyPlant, base: Frame) -> None:
    """Fixes the base to the world, unless the file has a joint for it already."""
    body = base.body()
    if body.index() == plant.world_body().index():
        return
    if not any(joint.child_body().index() == body.index() for joint in _joints(plant)):
        plant.WeldFrames(plant.world_frame(), base)


def _joints(plant: MultibodyPlant) -> list[Joint]:
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


def _joints_between(plant: MultibodyPlant, base: Frame, end: Frame) -> list[Joint]:
    """The joints from the base's body to the end's body, welds included."""
    inward = {joint.child_body().index(): joint for joint in _joints(plant)}
    path: list[Joint] = []
    body = end.body()
    while body.index() != base.body().index():
        joint = inward.get(body.index())
        if joint is None:
            raise ReachabilityError(
                f"no chain of joints leads from frame {base.name()!r} to {end.name()!r}; "
                "name a base frame on the way from the world to the end frame."
            )
        path.append(joint)
        body = joint.parent_body()
    return path[::-1]


def _chain(base: Frame, end: Frame, joints: list[Joint]) -> SerialChain:
    rows = []
    X = base.GetFixedPoseInBodyFrame().inverse()
    for joint in joints:
        X = X @ joint.frame_on_parent().GetFixedPoseInBodyFrame()
        after = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        if joint.num_positions() == 0:
            # Between its two frames, a weld may leave room.
            weld = joint.X_FM() if joint.type_name() == "weld" else RigidTransform()
            X = X @ weld @ after
            continue
        if isinstance(joint, RevoluteJoint):
            axis = joint.revolute_axis()
        elif isinstance(joint, PrismaticJoint):
            axis = joint.translation_axis()
        else:
            raise ReachabilityError(
                f"joint {joint.name()!r} is {joint.type_name()}; only revolute, prismatic and "
                "fixed joints are supported."
            )
        limits = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
        rows.append((X.GetAsMatrix4(), axis, isinstance(joint, PrismaticJoint), *limits))
        X = after
    if not rows:
        raise ReachabilityError(
            f"nothing moves between frame {base.name()!r} and {end.name()!r}: name the arm's ends."
        )
    X_JE = (X @ end.GetFixedPoseInBodyFrame()).GetAsMatrix4()
    X_PJ, axes, prismatic, lower, upper = map(np.array, zip(*rows, strict=True))
    return SerialChain(X_PJ, axes, prismatic, X_JE, lower, upper)
