"""The servo carries a free body exactly, yields like its spring, and lets go."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.systems.station.object_model import add_object
from feasigrasp.systems.station.object_servo import ObjectServo

DT = 0.002
FREQUENCY = 60.0


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

    def __init__(self, reference, folder, name="drill"):
        builder = DiagramBuilder()
        self.obj = load_object(name)
        self.motion = reference
        self.plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=DT), builder)
        instance = add_object(self.plant, self.obj, directory=folder)
        self.body = self.plant.GetBodyByName("object", instance)
        self.plant.SetDefaultFloatingBaseBodyPose(self.body, RigidTransform(reference.pose(0.0)))
        self.plant.Finalize()
        self.servo = builder.AddSystem(
            ObjectServo(self.plant, self.body.index(), reference, frequency=FREQUENCY)
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
    errors = [carried.error(round(k * 0.05, 9)) for k in range(8, 21)]
    assert max(np.linalg.norm(p) for p, _ in errors) < 2e-5
    assert max(np.linalg.norm(w) for _, w in errors) < 2e-4


def test_it_starts_without_the_reference_velocity_and_catches_up(tmp_path):
    carried = Carried(motion(0.12, spin=0.2), tmp_path)
    worst = max(np.linalg.norm(carried.error(round(k * DT, 9))[0]) for k in range(1, 60))
    speed = np.linalg.norm(carried.motion.velocity(0.0)[3:])
    # A critically damped spring that starts with velocity error v errs by v / (e w) at most; the
    # discrete one a little less, as it brakes over whole steps.
    assert 0.7 < worst * np.e * FREQUENCY / speed < 1.0


def test_it_yields_to_a_constant_force_like_its_spring(tmp_path):
    carried = Carried(motion(), tmp_path)
    force = np.array([1.0, -0.5, 2.0])
    carried.fix(push=np.r_[np.zeros(3), force])
    offset, turned = carried.error(0.5)
    np.testing.assert_allclose(offset, force / (carried.obj.mass * FREQUENCY**2), rtol=1e-3)
    np.testing.assert_allclose(turned, 0.0, atol=1e-6)
    carried.fix(push=np.zeros(6))
    assert np.linalg.norm(carried.error(1.0)[0]) < 1e-6


def test_it_yields_to_a_constant_torque_like_its_spring(tmp_path):
    carried = Carried(motion(), tmp_path)
    carried.fix(push=np.r_[0.01, -0.02, 0.005, np.zeros(3)])
    offset, turned = carried.error(0.5)
    I_W = carried.obj.inertia  # a resting reference without rotation
    expected = np.linalg.solve(I_W, [0.01, -0.02, 0.005]) / FREQUENCY**2
    np.testing.assert_allclose(turned, expected, rtol=0.02)
    np.testing.assert_allclose(offset, 0.0, atol=1e-6)


def test_let_go_it_applies_nothing_and_the_object_falls_freely(tmp_path):
    carried = Carried(motion(), tmp_path)
    start = carried.pose(0.2).translation()
    carried.fix(hold=0.0)
    steps = 100
    drop = carried.pose(0.2 + steps * DT).translation() - start
    # Semi-implicit Euler falls by g dt^2 n (n + 1) / 2.
    np.testing.assert_allclose(drop, [0, 0, -9.81 * DT**2 * steps * (steps + 1) / 2], atol=1e-6)
    servo_context = carried.servo.GetMyContextFromRoot(carried.context)
    assert carried.servo.get_output_port().Eval(servo_context) == []


def test_let_go_in_motion_it_flies_on(tmp_path):
    carried = Carried(motion(0.12, spin=0.2), tmp_path)
    start = carried.pose(0.4).translation()
    carried.fix(hold=0.0)
    moved = carried.pose(0.5).translation() - start
    ballistic = 0.1 * carried.motion.velocity(0.4)[3:] + [0, 0, -9.81 / 2 * 0.1**2]
    np.testing.assert_allclose(moved, ballistic, atol=2e-3)


def test_a_body_whose_origin_is_not_its_centre_of_mass_is_refused():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=DT), builder)
    inertia = SpatialInertia(1.0, [0.01, 0, 0], UnitInertia.SolidSphere(0.1))
    body = plant.AddRigidBody("stone", plant.AddModelInstance("stone"), inertia)
    plant.Finalize()
    with pytest.raises(ValueError, match="stone must be its centre of mass"):
        ObjectServo(plant, body.index(), motion())
