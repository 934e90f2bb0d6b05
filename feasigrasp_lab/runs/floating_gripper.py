"""Grasp test in simulation: a free gripper closes on the object, lifts and shakes it.

Cheap (well under a second of processor time each) and a screening only: an arm that gives way, the
approach and the object's own motion are not in it. The contact model is that of the dynamic runs.
"""

import tempfile
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import BodyIndex, PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.objects.spring_drive import DrivenBody, drive_wrench_kernel
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.systems.ports import declare_output, weakly
from feasigrasp.systems.station.cell_models import FINGER_KD, FINGER_KP
from feasigrasp.systems.station.directives import hand_urdf
from feasigrasp.systems.station.object_model import add_object, set_friction
from feasigrasp.systems.station.object_servo import force_on

#: Rate at which the distance between the pads shrinks, as in grasping [m/s]. Source: definition.
CLOSING_SPEED = 0.15
#: Its weight comes on the fingers within this time; then the hand lifts, and shakes [s]. Source:
#: definition.
RAMP_TIME, LIFT_TIME, SHAKE_PERIOD = 0.1, 0.2, 0.25
#: Acceleration of the lift and amplitude of the shaking along x, y, z in turn [m/s^2]. Source:
#: definition.
LIFT, SHAKE = 2.0, 4.0
#: Gravity [m/s^2]. Source: definition.
GRAVITY = 9.81


def load(time: float) -> np.ndarray:
    """Acceleration of a free thing in the frame of the hand, ``time`` after it was let go.

    The hand points down: its approach direction z is that of gravity. Its motion is given by
    d'Alembert's principle as forces on the object, while the hand stays where it is.

    Returns:
        In the grasp frame, shape (3,) [m/s^2].
    """
    acceleration = np.array([0.0, 0.0, GRAVITY * float(np.clip(time / RAMP_TIME, 0.0, 1.0))])
    lifting = time - RAMP_TIME
    if 0.0 <= lifting < LIFT_TIME:
        acceleration[2] += LIFT
    shaking = lifting - LIFT_TIME
    if shaking >= 0.0:
        axis = min(int(shaking / SHAKE_PERIOD), 2)
        acceleration[axis] += SHAKE * np.sin(2 * np.pi * shaking / SHAKE_PERIOD)
    return acceleration


class HandLoad(LeafSystem):
    """Closes the fingers of a hand that stays, and moves the object's weight onto them.

    .. pydrake_system::

        name: HandLoad
        input_ports:
        - state
        output_ports:
        - finger_state
        - spatial_force

    ``state`` is the object's V13 state; ``finger_state`` the desired position and speed of a finger
    (half the opening); ``spatial_force`` carries the object at its first pose until the fingers
    hold it, and is `load` times its mass from then on. That pose is a numeric parameter, see
    `set_pose`. The world is the grasp frame.

    Attributes:
        let_go: When the fingers have squeezed and the object is let go [s].
        end: When the last shake ends [s].
    """

    def __init__(self, plant: MultibodyPlant, body_index: BodyIndex, opening: float) -> None:
        """Loads one body of a finalized plant without gravity.

        Args:
            plant: The plant.
            body_index: The object; its origin is its centre of mass.
            opening: Distance between the open pads [m].
        """
        super().__init__()
        inertia = plant.get_body(body_index).default_spatial_inertia()
        self._body_index = body_index
        I_BBcm = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        # Frequency of the servo [rad/s]. Source: guessed.
        mass, w = inertia.get_mass(), 60.0  # critically damped
        spring = mass * w**2, 2.0 * mass * w, I_BBcm * w**2, 2.0 * I_BBcm * w
        self._object = DrivenBody(mass, I_BBcm, np.zeros(3), *spring)
        self._opening = opening
        # The object is carried, as before any grasp, until the fingers have squeezed so long [s].
        self.let_go = opening / CLOSING_SPEED + 0.15
        self.end = self.let_go + RAMP_TIME + LIFT_TIME + 3.0 * SHAKE_PERIOD
        self._state = self.DeclareVectorInputPort("state", 13)
        self._pose = self.DeclareNumericParameter(BasicVector(np.eye(4).ravel()))
        finger = weakly(self._calc_finger)
        self.DeclareVectorOutputPort("finger_state", 2, finger, {self.time_ticket()})
        force = [ExternallyAppliedSpatialForce()]
        declare_output(self, "spatial_force", self._calc_force, model=force)

    def set_pose(self, context: Context, X_GO: np.ndarray) -> None:
        """Sets where the object is carried, shape (4, 4)."""
        context.get_mutable_numeric_parameter(self._pose).SetFromVector(np.ravel(X_GO))

    def _calc_finger(self, context: Context, output: BasicVector) -> None:
        # Commanded distance between closed pads: they squeeze whatever is between [m].
        closed = -0.05
        opening = self._opening - CLOSING_SPEED * context.get_time()
        closing = opening > closed
        speed = -CLOSING_SPEED if closing else 0.0
        output.SetFromVector([0.5 * max(opening, closed), 0.5 * speed])

    def _calc_force(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        wrench = np.zeros(6)
        since = context.get_time() - self.let_go
        if since < 0.0:
            X_GO = context.get_numeric_parameter(self._pose).value().reshape(4, 4)
            state, still = self._state.Eval(context), (np.zeros(6), np.zeros(3))
            drive_wrench_kernel(state, np.ascontiguousarray(X_GO), *still, self._object, wrench)
        else:
            wrench[3:] = self._object.mass * load(since)
        return force_on(self._body_index, wrench)


#: As in the scenarios.
_PLANT = MultibodyPlantConfig(
    time_step=0.002,
    contact_model="hydroelastic_with_fallback",
    discrete_contact_approximation="lagged",
)


@dataclass(frozen=True)
class Trial:
    """What became of one grasp.

    Attributes:
        held: Whether the object is still between the pads after lift and shake.
        why: ``held``, ``missed`` (the pads met), ``pushed away`` while closing, ``dropped``, or
            ``solver failed``.
        turn_deg: How far the object turned in the hand since the fingers had closed [deg]; NaN if
            it was not let go.
    """

    held: bool
    why: str
    turn_deg: float = np.nan


class FloatingGripper:
    """One object and a gripper without an arm, for any number of trials.

    Args:
        obj: The object.
        gripper: The hand; its model is made of its description.
    """

    def __init__(self, obj: RigidObject, gripper: ParallelGripper) -> None:
        friction = 0.6  # Coulomb's, between pads and object
        self._opening = gripper.max_opening
        self._files = tempfile.TemporaryDirectory(prefix="feasigrasp-")
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlant(_PLANT, builder)
        plant = self._plant
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))  # HandLoad's business
        (hand,) = Parser(plant).AddModels(str(hand_urdf(gripper)))
        instance = add_object(plant, obj, directory=self._files.name, friction=friction)
        self._body = plant.GetBodyByName("object", instance)
        grasp_frame = plant.GetFrameByName("grasp_frame", hand)
        base = plant.GetBodyByName("gripper_body", hand).body_frame()
        X_BG = grasp_frame.GetFixedPoseInBodyFrame()
        plant.WeldFrames(plant.world_frame(), base, X_BG.inverse())
        finger = plant.GetJointActuatorByName("left_finger_joint", hand)
        finger.set_controller_gains(PdControllerGains(p=FINGER_KP, d=FINGER_KD))
        set_friction(plant, scene_graph, hand, friction)
        plant.Finalize()
        self._joints = [plant.GetJointByName(f"{side}_finger_joint") for side in ("left", "right")]

        self._load = builder.AddNamedSystem(
            "hand_load", HandLoad(plant, self._body.index(), self._opening)
        )
        builder.Connect(plant.get_state_output_port(instance), self._load.GetInputPort("state"))
        builder.Connect(
            self._load.GetOutputPort("finger_state"), plant.get_desired_state_input_port(hand)
        )
        builder.Connect(
            self._load.GetOutputPort("spatial_force"), plant.get_applied_spatial_force_input_port()
        )
        self._diagram = builder.Build()
        self._simulator = Simulator(self._diagram)

    def try_grasp(self, X_OG: ArrayLike) -> Trial:
        """Closes, lifts and shakes with the hand at one grasp (4, 4)."""
        X_GO = RigidTransform(np.asarray(X_OG, dtype=float)).inverse()
        context = self._diagram.CreateDefaultContext()
        plant_context = self._plant.GetMyMutableContextFromRoot(context)
        self._plant.SetFreeBodyPose(plant_context, self._body, X_GO)
        for joint in self._joints:
            joint.set_translation(plant_context, 0.5 * self._opening)
        self._load.set_pose(self._load.GetMyMutableContextFromRoot(context), X_GO.GetAsMatrix4())
        self._simulator.reset_context(context)
        let_go, end = self._load.let_go, self._load.end
        try:
            self._simulator.Initialize()
            self._simulator.AdvanceTo(let_go)
            trial = self._verdict(plant_context, X_GO, closing=True)
            R_GO = self._plant.EvalBodyPoseInWorld(plant_context, self._body).rotation()
            # Time between two looks at the object [s]. Source: guessed.
            for time in (*np.arange(let_go, end, 0.1)[1:], end):
                if not trial.held:
                    break
                self._simulator.AdvanceTo(time)
                trial = self._verdict(plant_context, X_GO, closing=False)
                R_GO_now = self._plant.EvalBodyPoseInWorld(plant_context, self._body).rotation()
                turn = R_GO.InvertAndCompose(R_GO_now).ToAngleAxis().angle()
                trial = replace(trial, turn_deg=float(np.rad2deg(turn)))
        except RuntimeError:
            return Trial(False, "solver failed")
        return trial

    def _verdict(self, context, X_GO: RigidTransform, closing: bool) -> Trial:
        # Pads closer than this hold nothing [m]. Source: guessed.
        empty = 5e-4
        opening = sum(joint.get_translation(context) for joint in self._joints)
        # The point of the object that was between the pads, which is the origin.
        X_GO_now = self._plant.EvalBodyPoseInWorld(context, self._body)
        moved = np.linalg.norm(X_GO_now.multiply(X_GO.inverse().translation()))
        if closing and opening < empty:
            return Trial(False, "missed")
        # The point that was between the pads may move this far from there [m].
        if moved > 0.03 or opening < empty:
            return Trial(False, "pushed away" if closing else "dropped")
        return Trial(True, "held")
