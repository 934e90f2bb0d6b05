"""Tries grasps out: a gripper without an arm closes on the object, lifts it and shakes it.

Cheap (well under a second of processor time each) and a screening only: an arm that gives way, the
approach and the object's own motion are not in it. The contact model is that of the dynamic runs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.systems.station.cell_models import FINGER_KD, FINGER_KP
from feasigrasp.systems.station.directives import hand_urdf
from feasigrasp.systems.station.friction import set_friction
from feasigrasp.systems.station.object_model import add_object
from feasigrasp_lab.runs.hand_load import HandLoad

#: As in the scenarios.
_PLANT = MultibodyPlantConfig(
    time_step=0.002,
    contact_model="hydroelastic_with_fallback",
    discrete_contact_approximation="lagged",
)
#: The point that was between the pads may move this far from there [m].
HELD_WITHIN = 0.03
#: Pads closer than this hold nothing [m].
_EMPTY = 5e-4
_CHECK_EVERY = 0.1


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
        friction: Coulomb friction between pads and object.
    """

    def __init__(self, obj: RigidObject, gripper: ParallelGripper, friction: float = 0.6) -> None:
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
            self._load.GetOutputPort("spatial_force"),
            plant.get_applied_spatial_force_input_port(),
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
            for time in (*np.arange(let_go, end, _CHECK_EVERY)[1:], end):
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
        opening = sum(joint.get_translation(context) for joint in self._joints)
        # The point of the object that was between the pads, which is the origin.
        X_GO_now = self._plant.EvalBodyPoseInWorld(context, self._body)
        moved = np.linalg.norm(X_GO_now.multiply(X_GO.inverse().translation()))
        if closing and opening < _EMPTY:
            return Trial(False, "missed")
        if moved > HELD_WITHIN or opening < _EMPTY:
            return Trial(False, "pushed away" if closing else "dropped")
        return Trial(True, "held")


def hold_trials(
    obj: RigidObject,
    X_OG: ArrayLike,
    gripper: ParallelGripper | None = None,
    *,
    friction: float = 0.6,
) -> Sequence[Trial]:
    """Tries grasps of one object.

    Args:
        obj: The object.
        X_OG: Grasp frames in its frame O, shape (n, 4, 4).
        gripper: The hand.
        friction: Coulomb friction between pads and object.
    """
    hand = FloatingGripper(obj, gripper or ParallelGripper(), friction)
    return [hand.try_grasp(X) for X in np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)]
