"""The servo carries a free body exactly, yields like its carrier's spring, and lets go."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.objects.spring_drive import (
    DAMPING_RATIO,
    SPRINGS,
    CarrierHold,
    Compliance,
    Release,
    carried_body,
)
from feasigrasp.systems.station.object_model import add_object
from feasigrasp.systems.station.object_servo import ObjectServo

DT = 0.002
SOFT, RIGID = SPRINGS[Compliance.SOFT], SPRINGS[Compliance.RIGID]


def motion(amplitude=0.0, spin=0.0):
    return HarmonicMotion(
        center=np.array([0.5, 0.1, 0.55]),
        amplitude=np.full(3, amplitude),
        harmonic=np.array([1.0, 1.0, 2.0]),
        offset_deg=np.array([90.0, 0.0, 30.0]),
        rate=0.2 * np.pi,
        start_phase=0.7,
        spin_axis=np.array([1.0, -2.0, 0.5]),
        spin=spin,
    )


class Carried:
    """A free object on a servo, in an otherwise empty world."""

    def __init__(
        self, reference, folder, name="drill", spring=SOFT, *, mass=None, step=DT, **release
    ):
        builder = DiagramBuilder()
        self.obj = load_object(name, mass=mass)
        self.motion = reference
        self.plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=step), builder)
        instance = add_object(self.plant, self.obj, directory=folder)
        self.body = self.plant.GetBodyByName("object", instance)
        self.plant.SetDefaultFloatingBaseBodyPose(self.body, RigidTransform(reference.pose(0.0)))
        self.plant.Finalize()
        self.servo = builder.AddSystem(
            ObjectServo(self.plant, self.body.index(), reference, CarrierHold(spring, **release))
        )
        builder.Connect(
            self.plant.get_state_output_port(instance), self.servo.GetInputPort("state")
        )
        builder.Connect(
            self.servo.GetOutputPort("spatial_force"),
            self.plant.get_applied_spatial_force_input_port(),
        )
        builder.ExportInput(self.servo.GetInputPort("hold"), "hold")
        # For a floating base: torque and force in the world, at the body's origin.
        builder.ExportInput(self.plant.get_applied_generalized_force_input_port(), "push")
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.fix(hold=1.0)
        self.fix(push=np.zeros(6))

    def fix(self, **values):
        for name, value in values.items():
            self.diagram.GetInputPort(name).FixValue(self.context, value)

    def pose(self, t):
        self.simulator.AdvanceTo(t)
        context = self.plant.GetMyContextFromRoot(self.context)
        return self.plant.EvalBodyPoseInWorld(context, self.body)

    def error(self, t):
        """Offset of position [m] and rotation vector [rad] from the reference."""
        X = RigidTransform(self.motion.pose(t)).inverse() @ self.pose(t)
        R_WR = self.motion.pose(t)[:3, :3]
        angle_axis = X.rotation().ToAngleAxis()
        return R_WR @ X.translation(), angle_axis.angle() * R_WR @ angle_axis.axis()


def test_ports_are_those_of_the_docstring(tmp_path, ports, documented_ports):
    inputs, outputs = ports(Carried(motion(), tmp_path).servo)
    assert (list(inputs), list(outputs)) == documented_ports(ObjectServo)
    assert inputs == {"state": 13, "hold": 1}


def test_it_follows_its_reference(tmp_path):
    carried = Carried(motion(0.12, spin=0.2), tmp_path)
    errors = [carried.error(round(k * 0.05, 9)) for k in range(30, 43)]
    assert max(np.linalg.norm(p) for p, _ in errors) < 2e-5
    assert max(np.linalg.norm(w) for _, w in errors) < 2e-4


#: A light and a heavy object, on the softest and the stiffest spring, at the step of the runs.
STEP = 0.0025
CASES = [
    (name, mass, compliance)
    for name, mass in (("ball", 0.06), ("water_bottle", 1.0))
    for compliance in Compliance
]


@pytest.mark.parametrize(("name", "mass", "compliance"), CASES)
def test_it_yields_to_a_constant_push_by_force_over_stiffness(tmp_path, name, mass, compliance):
    """The stiffness is the carrier's, whatever the mass of the object."""
    spring = SPRINGS[compliance]
    carried = Carried(motion(), tmp_path, name, spring, mass=mass, step=STEP)
    force = np.array([1.0, -0.5, 2.0])
    carried.fix(push=np.r_[np.zeros(3), force])
    offset, turned = carried.error(2.0)
    np.testing.assert_allclose(offset, force / spring.stiffness, rtol=1e-3)
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    carried.fix(push=np.zeros(6))
    assert np.linalg.norm(carried.error(4.0)[0]) < 1e-6


def test_it_yields_to_a_constant_torque_by_torque_over_stiffness(tmp_path):
    carried = Carried(motion(), tmp_path, "water_bottle", SOFT, mass=1.0, step=STEP)
    torque = np.array([0.01, -0.02, 0.005])
    carried.fix(push=np.r_[torque, np.zeros(3)])
    offset, turned = carried.error(2.0)
    np.testing.assert_allclose(turned, torque / SOFT.angular_stiffness, rtol=0.01)
    np.testing.assert_allclose(offset, 0.0, atol=1e-6)


def test_a_light_object_turns_on_the_stiffest_spring_that_the_step_integrates(tmp_path):
    """About every axis ``i (w/dt)^2``, which is less than the carrier's; and it comes to rest."""
    carried = Carried(motion(), tmp_path, "ball", RIGID, step=STEP)
    body = carried_body(carried.obj.mass, carried.obj.inertia, np.zeros(3), RIGID, STEP)
    assert np.linalg.eigvalsh(body.K_B).max() < RIGID.angular_stiffness
    torque = np.array([0.01, -0.02, 0.005])
    carried.fix(push=np.r_[torque, np.zeros(3)])
    R_WB = carried.motion.pose(0.0)[:3, :3]
    expected = R_WB @ np.linalg.solve(body.K_B, R_WB.T @ torque)
    np.testing.assert_allclose(carried.error(1.0)[1], expected, rtol=0.02)
    carried.fix(push=np.zeros(6))
    assert np.linalg.norm(carried.error(2.0)[1]) < 1e-6


@pytest.mark.parametrize(("name", "mass", "compliance"), CASES)
def test_a_push_dies_away_as_the_steps_of_a_damped_oscillator(tmp_path, name, mass, compliance):
    """By the recursion of semi-implicit Euler, and the damping ratio in the limit of small steps.

    ``v' = v - dt (2 z w v + w^2 x)``, ``x' = x + dt v'``.
    """
    spring = SPRINGS[compliance]
    carried = Carried(motion(), tmp_path, name, spring, mass=mass, step=STEP)
    push, at_rest = np.array([0.0, 0.0, 2.0]), 3.0
    carried.fix(push=np.r_[np.zeros(3), push])
    x, v = carried.error(at_rest)[0][2], 0.0
    carried.fix(push=np.zeros(6))
    w, expected, found = np.sqrt(spring.stiffness / mass), [], []
    for k in range(1, 121):
        v -= STEP * (2.0 * DAMPING_RATIO * w * v + w**2 * x)
        x += STEP * v
        expected.append(x)
        found.append(carried.error(at_rest + k * STEP)[0][2])
    np.testing.assert_allclose(found, expected, atol=0.01 * push[2] / spring.stiffness)
    if w * STEP < 0.1:  # the first swing to the other side: e^(-pi z / sqrt(1 - z^2))
        swing = np.exp(-np.pi * DAMPING_RATIO / np.sqrt(1.0 - DAMPING_RATIO**2))
        first = -min(expected) / (push[2] / spring.stiffness)
        assert first == pytest.approx(swing, rel=0.25)


def test_it_starts_without_the_reference_velocity_and_catches_up(tmp_path):
    carried = Carried(motion(0.12, spin=0.2), tmp_path)
    w = np.sqrt(SOFT.stiffness / carried.obj.mass)
    worst = max(np.linalg.norm(carried.error(round(k * DT, 9))[0]) for k in range(1, 120))
    speed = np.linalg.norm(carried.motion.velocity(0.0)[3:])
    # A spring that starts with velocity error v errs by v / w e^(-z t w) at its first turn.
    angle = np.arccos(DAMPING_RATIO)
    assert worst == pytest.approx(speed / w * np.exp(-angle / np.tan(angle)), rel=0.05)


def test_let_go_it_applies_nothing_and_the_object_falls_freely(tmp_path):
    carried = Carried(motion(), tmp_path)
    carried.pose(0.2 - DT)
    carried.fix(hold=0.0)
    start = carried.pose(0.2).translation()  # it takes one step
    steps = 100
    drop = carried.pose(0.2 + steps * DT).translation() - start
    # Semi-implicit Euler falls by g dt^2 n (n + 1) / 2.
    np.testing.assert_allclose(drop, [0, 0, -9.81 * DT**2 * steps * (steps + 1) / 2], atol=1e-6)
    servo_context = carried.servo.GetMyContextFromRoot(carried.context)
    assert carried.servo.GetOutputPort("spatial_force").Eval(servo_context) == []
    let_go = carried.servo.GetOutputPort("let_go").Eval(servo_context)[0]
    assert let_go == pytest.approx(0.2 - DT, abs=1e-9)


def height(carried, t):
    return carried.pose(t).translation()[2]


def test_a_late_release_is_as_late_as_it_says(tmp_path):
    carried = Carried(motion(), tmp_path, delay=0.3)
    start = height(carried, 0.2)
    carried.fix(hold=0.0)
    assert height(carried, 0.5) == pytest.approx(start, abs=1e-6)
    carried.fix(hold=1.0)  # a command that is taken back comes too late
    assert start - height(carried, 0.7) == pytest.approx(9.81 / 2 * 0.2**2, rel=0.05)


@pytest.mark.parametrize(("share", "goes"), [(0.4, False), (0.6, True)])
def test_a_release_by_the_load_waits_until_half_of_the_weight_is_borne(tmp_path, share, goes):
    """And for 0.1 s; before the command nothing lets go."""
    carried = Carried(motion(), tmp_path, release=Release.LOAD)
    weight = 9.81 * carried.obj.mass
    carried.fix(push=[0.0, 0.0, 0.0, 0.0, 0.0, share * weight])
    start = height(carried, 1.0)
    carried.fix(hold=0.0)
    height(carried, 1.08)
    servo_context = carried.servo.GetMyContextFromRoot(carried.context)
    port = carried.servo.GetOutputPort("let_go")
    assert port.Eval(servo_context)[0] == np.inf
    fell = start - height(carried, 1.4)
    assert (port.Eval(servo_context)[0] == pytest.approx(1.1, abs=2 * DT)) == goes
    assert (fell > 0.1) == goes


def test_let_go_in_motion_it_flies_on(tmp_path):
    carried = Carried(motion(0.12, spin=0.2), tmp_path)
    carried.pose(1.0 - DT)
    carried.fix(hold=0.0)
    start = carried.pose(1.0).translation()
    moved = carried.pose(1.1).translation() - start
    ballistic = 0.1 * carried.motion.velocity(1.0)[3:] + [0, 0, -9.81 / 2 * 0.1**2]
    np.testing.assert_allclose(moved, ballistic, atol=2e-3)


def test_a_body_whose_origin_is_not_its_centre_of_mass_is_refused():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=DT), builder)
    inertia = SpatialInertia(1.0, [0.01, 0, 0], UnitInertia.SolidSphere(0.1))
    body = plant.AddRigidBody("stone", plant.AddModelInstance("stone"), inertia)
    plant.Finalize()
    with pytest.raises(ValueError, match="stone must be its centre of mass"):
        ObjectServo(plant, body.index(), motion(), CarrierHold(SOFT))
