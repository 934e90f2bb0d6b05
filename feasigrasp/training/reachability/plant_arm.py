"""Takes a serial arm out of a Drake plant: its chain, and its self-collisions.

Any model that Drake's parser reads will do: a model directives file, URDF, SDFormat or MJCF.
"""

from __future__ import annotations

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
from feasigrasp.models.arrays import Mask
from feasigrasp.resources import model_path
from feasigrasp.training.reachability.serial_chain import SerialChain


class PlantArm:
    """An arm of a model file, ready for `feasigrasp.training.reachability.reachable_poses`.

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
    frames, axes, prismatic, lower, upper = [], [], [], [], []
    X = base.GetFixedPoseInBodyFrame().inverse()
    for joint in joints:
        X = X @ joint.frame_on_parent().GetFixedPoseInBodyFrame()
        if joint.num_positions() > 0:
            if isinstance(joint, RevoluteJoint):
                axis = joint.revolute_axis()
            elif isinstance(joint, PrismaticJoint):
                axis = joint.translation_axis()
            else:
                raise ReachabilityError(
                    f"joint {joint.name()!r} is {joint.type_name()}; only revolute, prismatic and "
                    "fixed joints are supported."
                )
            frames.append(X.GetAsMatrix4())
            axes.append(axis)
            prismatic.append(isinstance(joint, PrismaticJoint))
            lower.append(joint.position_lower_limits()[0])
            upper.append(joint.position_upper_limits()[0])
            X = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
        else:
            # Between its two frames, a weld may leave room.
            weld = joint.X_FM() if joint.type_name() == "weld" else RigidTransform()
            X = X @ weld @ joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
    if not axes:
        raise ReachabilityError(
            f"nothing moves between frame {base.name()!r} and {end.name()!r}: name the arm's ends."
        )
    X = X @ end.GetFixedPoseInBodyFrame()
    return SerialChain(
        np.array(frames),
        np.array(axes),
        np.array(prismatic),
        X.GetAsMatrix4(),
        np.array(lower),
        np.array(upper),
    )
