"""Checks that a robot cell matches the kinematics, limits and hand of the package."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from pydrake.systems.framework import Context

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.capsules import link_poses
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import tool_pose

#: A frame that is off by less is the same; rounded angles of a model file are [m], [rad]. Source:
#: guessed.
POSITION_TOLERANCE, ANGLE_TOLERANCE = 2e-4, 1e-3
FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")


def check_cell(
    plant: MultibodyPlant, gripper: Gripper, arm: Arm = IIWA_7, hand_error: Array | None = None
) -> None:
    """Compares a finalized plant with the arm and the hand that the project computes with.

    Frames are compared from the base to the hand, in a configuration that turns every joint, so
    that a joint's place, axis, sign and zero all show; the first one that is off is named. Joints
    may have no limits at all (as where nothing is enforced), or higher ones than ours for speed,
    acceleration and effort, but no lower ones. With a ``hand_error`` (4, 4) the hand is expected to
    be off by that.

    Raises:
        ScenarioError: The cell is another one; the message names part, amount and mend.
    """
    instance = _instance(plant, arm.name)
    context = plant.CreateDefaultContext()
    q = np.where(np.arange(arm.joints) % 2, -1.0, 1.0) * np.linspace(0.4, 1.0, arm.joints)
    q = np.clip(q, arm.lower, arm.upper)
    _check_joint_names(plant, instance, arm)
    plant.SetPositions(context, instance, q)
    X_WF = tool_pose(q, None, arm)
    links = map(se3.make_pose, *link_poses(arm.chain, q))
    for name, X_WL in zip(arm.link_names, links, strict=True):
        _compare(plant.GetFrameByName(name, instance), context, X_WL, _LINK_MEND)
    _compare(plant.GetFrameByName(f"{arm.name}_flange", instance), context, X_WF, _LINK_MEND)
    _check_limits(plant, instance, arm)
    X_WG = X_WF @ gripper.X_FG
    _check_hand(plant, context, X_WG if hand_error is None else X_WG @ hand_error, gripper)


_LINK_MEND = (
    "kinematics, inverse kinematics and reachability are those of this arm with its base at the "
    "world's origin: correct the directives of the cell, or the scenario's arm"
)
_HAND_MEND = (
    "grasps are planned for the hand that ParallelGripper describes: weld "
    "package://feasigrasp/iiwa/gripper.urdf to iiwa_flange as cell.dmd.yaml does, or describe this "
    "hand in a file, whose model is then made: gripper: FILE.yaml"
)


def _instance(plant: MultibodyPlant, name: str) -> ModelInstanceIndex:
    if not plant.HasModelInstanceNamed(name):
        found = ", ".join(
            plant.GetModelInstanceName(ModelInstanceIndex(i))
            for i in range(2, plant.num_model_instances())
        )
        raise ScenarioError(
            f"the cell has no model named {name!r} (it has {found or 'none'}); name it so in the "
            "directives, as cell.dmd.yaml does"
        )
    return plant.GetModelInstanceByName(name)


def _check_joint_names(plant: MultibodyPlant, instance: ModelInstanceIndex, arm: Arm) -> None:
    names = [plant.get_joint(i).name() for i in plant.GetJointIndices(instance)]
    moving = [name for name in names if plant.GetJointByName(name, instance).num_positions() > 0]
    if moving != list(arm.joint_names):
        raise ScenarioError(
            f"the joints of {arm.name} are {', '.join(moving)}; expected are "
            f"{', '.join(arm.joint_names)}, in this order; {_LINK_MEND}"
        )


def _compare(frame: Frame, context: Context, X_WE: Array, mend: str) -> None:
    """Raises if a frame of the plant is not where it is expected (E)."""
    X_EF = RigidTransform(X_WE).inverse() @ frame.CalcPoseInWorld(context)
    p, angle = X_EF.translation(), abs(X_EF.rotation().ToAngleAxis().angle())
    if np.linalg.norm(p) > POSITION_TOLERANCE or angle > ANGLE_TOLERANCE:
        raise ScenarioError(
            f"{frame.name()} of the cell is {1e3 * np.linalg.norm(p):.1f} mm and "
            f"{np.rad2deg(angle):.2f} degrees from where it is expected (by "
            f"{np.round(1e3 * p, 1).tolist()} mm along its expected axes); {mend}"
        )


def _check_limits(plant: MultibodyPlant, instance: ModelInstanceIndex, arm: Arm) -> None:
    # A limit may be rounded by this share. Source: guessed.
    limit_tolerance = 1e-3
    for i, name in enumerate(arm.joint_names):
        joint = plant.GetJointByName(name, instance)
        for theirs, ours, what in (
            (joint.position_lower_limits()[0], arm.lower[i], "from"),
            (joint.position_upper_limits()[0], arm.upper[i], "to"),
        ):
            if np.isfinite(theirs) and abs(theirs - ours) > limit_tolerance * abs(ours):
                raise ScenarioError(
                    f"{name} of the cell turns {what} {np.rad2deg(theirs):.2f} degrees, "
                    f"{np.rad2deg(ours):.2f} are expected; {_LINK_MEND}"
                )
        actuator = plant.GetJointActuatorByName(name, instance)
        velocity, acceleration = joint.velocity_upper_limits(), joint.acceleration_upper_limits()
        for what, unit, theirs, ours in (
            ("velocity", "rad/s", velocity[0], arm.velocity_limits[i]),
            ("acceleration", "rad/s^2", acceleration[0], arm.acceleration_limits[i]),
            ("effort", "Nm", actuator.effort_limit(), arm.effort_limits[i]),
        ):
            if theirs < (1.0 - limit_tolerance) * ours:
                raise ScenarioError(
                    f"{name} of the cell has a {what} limit of {theirs:.4g} {unit}, motions are "
                    f"planned with {ours:.4g}; lower it in the scenario's arm, or raise it in the "
                    "model"
                )


def _check_hand(plant: MultibodyPlant, context: Context, X_WG: Array, gripper: Gripper) -> None:
    hand = _instance(plant, "gripper")
    if not isinstance(gripper, ParallelGripper):
        _compare(plant.GetFrameByName("grasp_frame", hand), context, X_WG, _HAND_MEND)
        return
    for name in FINGER_JOINTS:
        if not plant.HasJointNamed(name, hand):
            raise ScenarioError(f"the gripper of the cell has no {name}; {_HAND_MEND}")
        joint = plant.GetJointByName(name, hand)
        joint.set_translation(context, 0.0)
        _compare(joint.child_body().body_frame(), context, X_WG, _HAND_MEND)
    joints = (plant.GetJointByName(name, hand) for name in FINGER_JOINTS)
    opening = sum(joint.position_upper_limits()[0] for joint in joints)
    if abs(opening - gripper.max_opening) > POSITION_TOLERANCE:
        raise ScenarioError(
            f"the gripper of the cell opens {1e3 * opening:.1f} mm, "
            f"{1e3 * gripper.max_opening:.1f} are expected; {_HAND_MEND}"
        )
