"""Description of the robot cell, its models in a plant, and boxes about them."""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydrake.common.schema import Transform
from pydrake.geometry import Box, HalfSpace
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import (
    FlattenModelDirectives,
    ModelDirective,
    ModelDirectives,
    PackageMap,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.faults.object import ObjectPulled
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.distractor_bodies import DistractorBody
from feasigrasp.models.objects.spring_drive import CarrierHold
from feasigrasp.models.quantities import CONFIGURATION, POSE, NotNegative, Whole
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.segmentation.modeled_bodies import Boxes
from feasigrasp.models.sensors.camera_errors import HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.models.sensors.joint_errors import JointErrors
from feasigrasp.resources import model_path
from feasigrasp.scenario.cell import CarrierConfig
from feasigrasp.scenario.schema import ObjectConfig
from feasigrasp.systems.station.directives import loading

#: The gripper's position controller [N/m]: saturates at the finger's effort limit when squeezing.
#: Source: guessed.
FINGER_KP, FINGER_KD = 3000.0, 60.0


@dataclass
class StationConfig:
    """Configuration of the station.

    Attributes:
        plant: Drake's plant settings.
        directives: Model directives with model instances of the arm's name and ``gripper``.
        arm: The arm.
        gripper: The hand that they have.
        cameras: Cameras by name.
        q_start: Joint positions at the start [rad], shape (7,).
        friction: Coulomb friction between the gripper and the object.
        enforce_constraints: Whether joints have end stops and the robot is blocked by itself and by
            its cell. The paper's tests are "without constraints": joints turn on, links pass
            through each other, and there is no table. What goes beyond is counted.
        touch_object: Whether robot and object touch. The paper's dynamic test puts the object back
            on its path at every step, whatever touches it.
        camera_noise: Errors of the depth images, by camera; a camera not named has none.
        hand_eye: Errors of the hand-eye calibration, by camera, likewise.
        joint_errors: Errors of encoders and external torques.
        noise_seed: Seed of those errors.
        hand_error: Where the hand truly is, in the frame of the one that is planned with, shape
            (4, 4) [m].
        carrier: How the object is held and let go.
        pulls: What pulls at the object once it is let go.
        distractor_bodies: Carrier and distractor.
    """

    plant: MultibodyPlantConfig
    directives: list[ModelDirective] = field(default_factory=list)
    gripper: Gripper = field(default_factory=ParallelGripper)
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    arm: Arm = IIWA_7
    q_start: Annotated[np.ndarray, CONFIGURATION] = field(
        default_factory=lambda: np.zeros(IIWA_7.joints)
    )
    friction: NotNegative = ObjectConfig.friction
    enforce_constraints: bool = True
    touch_object: bool = True
    camera_noise: dict[str, DepthNoise] = field(default_factory=dict)
    hand_eye: dict[str, HandEyeError] = field(default_factory=dict)
    joint_errors: JointErrors = field(default_factory=lambda: JointErrors(0.0, 0.0, 0.0, 0.0))
    noise_seed: Whole = 0
    hand_error: Annotated[np.ndarray, POSE] = field(default_factory=lambda: np.eye(4))
    carrier: CarrierHold = field(default_factory=lambda: CarrierConfig().hold)
    pulls: list[ObjectPulled] = field(default_factory=list)
    distractor_bodies: list[DistractorBody] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Checks what it is made of.

        Raises:
            ScenarioError: An entry has another type, shape or range.
        """
        check_fields(self, ScenarioError)
        if len(self.q_start) != self.arm.joints:
            raise ScenarioError(
                f"StationConfig.q_start has {len(self.q_start)} entries; give {self.arm.joints}"
            )


def add_cell(plant: MultibodyPlant, config: StationConfig) -> None:
    """Adds the arm, its hand and the static cell to a plant.

    Raises:
        ScenarioError: Drake cannot load the directives.
    """
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    with loading():
        directives = _with_hand_error(config, parser.package_map())
        ProcessModelDirectives(directives, plant, parser)
    arm = config.arm
    instance = plant.GetModelInstanceByName(arm.name)
    for name, kp, kd, q in zip(arm.joint_names, arm.kp, arm.kd, config.q_start, strict=True):
        joint = plant.GetJointByName(name, instance)
        actuator = plant.GetJointActuatorByName(name, instance)
        actuator.set_controller_gains(PdControllerGains(p=kp, d=kd))
        joint.set_default_positions([q])
        if not config.enforce_constraints:
            joint.set_position_limits([-np.inf], [np.inf])
            actuator.set_effort_limit(np.inf)
    # The real arm compensates its own weight and its tool's.
    for instance in robot_instances(plant, arm):
        plant.set_gravity_enabled(instance, False)
    if not isinstance(config.gripper, ParallelGripper):
        return
    gripper = plant.GetModelInstanceByName("gripper")
    finger = plant.GetJointActuatorByName("left_finger_joint", gripper)
    finger.set_controller_gains(PdControllerGains(p=FINGER_KP, d=FINGER_KD))
    for name in ("left_finger_joint", "right_finger_joint"):
        joint = plant.GetJointByName(name, gripper)
        lower, upper = joint.position_lower_limits(), joint.position_upper_limits()
        joint.set_default_positions(upper)
        # The end stops of the fingers are this far beyond where they are open [m]. Fingers that
        # just touch them make the contact solver give up when the whole cell is at rest.
        joint.set_position_limits(lower, upper + 5e-5)


def _with_hand_error(config: StationConfig, packages: PackageMap) -> ModelDirectives:
    """The directives of the cell, with the hand welded to the flange as far off as it errs."""
    directives = ModelDirectives(directives=config.directives)
    if np.array_equal(config.hand_error, np.eye(4)):
        return directives
    directives = FlattenModelDirectives(directives, packages)
    X_FG = config.gripper.X_FG
    X_FF = RigidTransform(X_FG @ config.hand_error @ se3.inverse(X_FG))
    for each in directives.directives:
        if each.add_weld is not None and each.add_weld.child.startswith("gripper::"):
            given = each.add_weld.X_PC
            X_PC = RigidTransform() if given is None else given.GetDeterministicValue()
            each.add_weld.X_PC = Transform(X_FF @ X_PC)
    return directives


def robot_instances(plant: MultibodyPlant, arm: Arm) -> list[ModelInstanceIndex]:
    """Model instances of the arm and its attachments."""
    names = filter(plant.HasModelInstanceNamed, (arm.name, "gripper", "camera"))
    return [plant.GetModelInstanceByName(name) for name in names]


def cell_boxes(config: StationConfig, models: Collection[str] | None = None) -> Boxes:
    """A box about each collision geometry that is fixed to the world and not the arm's base.

    Of a box that is the box itself, of anything else Drake's oriented bounding box. Of ``models``
    these count; None for all.
    """
    # Half the size of a box that stands for a half space [m].
    half_space = 10.0
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(config.plant, builder)
    add_cell(plant, config)
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    inspector, robot = scene_graph.model_inspector(), robot_instances(plant, config.arm)
    poses, halves, solid = [], [], []
    for body in plant.GetBodiesWeldedTo(plant.world_body()):
        name = plant.GetModelInstanceName(body.model_instance())
        if body.model_instance() in robot or (models is not None and name not in models):
            continue
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            solid.append(isinstance(shape, Box | HalfSpace))
            if isinstance(shape, HalfSpace):
                below = RigidTransform([0.0, 0.0, -half_space])
                poses.append((query.GetPoseInWorld(geometry) @ below).GetAsMatrix4())
                halves.append(np.full(3, half_space))
                continue
            box = query.ComputeObbInWorld(geometry)
            poses.append(box.pose().GetAsMatrix4())
            halves.append(box.half_width())
    if not poses:
        return Boxes()
    return Boxes(np.array(poses), np.array(halves), np.array(solid))
