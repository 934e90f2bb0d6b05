"""The simulated seal of a suction cup holds, and breaks at the cup's limits."""

import numpy as np
import pytest
import trimesh
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    ExternallyAppliedSpatialForce,
    MultibodyPlantConfig,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.geometry.se3 import make_pose, so3_exp
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import SuctionCup
from feasigrasp.runs.run import run
from feasigrasp.systems.hardware.station import HardwareStation
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.ports import declare_output
from feasigrasp.systems.station.directives import hand_urdf
from feasigrasp.systems.station.object_model import add_object
from feasigrasp.systems.station.object_servo import SuctionSeal, force_on
from tests.held import seeded

CUP, STEP, G = SuctionCup(), 0.0025, 9.81
SIDE, MASS = 0.06, 0.3
BOX = trimesh.creation.box([SIDE] * 3)
X_WG = make_pose(so3_exp([np.pi, 0.0, 0.0]), [0.0, 0.0, 0.5])  # the cup looks down


class Pull(LeafSystem):
    """A wrench on the object that grows with time from 0.3 s on."""

    def __init__(self, body, per_second):
        super().__init__()
        self._body, self._rate = body, np.asarray(per_second, dtype=float)
        declare_output(self, "force", self._calc, model=[ExternallyAppliedSpatialForce()])

    def at(self, t):
        return self._rate * max(0.0, t - 0.3)

    def _calc(self, context):
        return force_on(self._body, self.at(context.get_time()))


class Hanging:
    """An object under a cup that is fixed in the world, with its vacuum on."""

    def __init__(self, folder, mesh=BOX, per_second=(0, 0, 0, 0, 0, 0), drop=0.0):
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlant(MultibodyPlantConfig(time_step=STEP), builder)
        (hand,) = Parser(plant).AddModels(str(hand_urdf(CUP)))
        X_WF = RigidTransform(X_WG @ np.linalg.inv(CUP.X_FG))
        gripper = plant.GetFrameByName("gripper_body", hand)
        self.weld = int(plant.WeldFrames(plant.world_frame(), gripper, X_WF).index())
        obj = RigidObject.of_mesh("object", mesh, MASS)
        instance = add_object(plant, obj, directory=folder)
        body = plant.GetBodyByName("object", instance)
        top = 0.5 - float(obj.vertices[:, 2].max()) + 0.0005 - drop
        plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform([0.0, 0.0, top]))
        plant.Finalize()
        self.seal = builder.AddSystem(SuctionSeal(plant, CUP, obj))
        self.pull = builder.AddSystem(Pull(body.index(), per_second))
        for name, port in (
            ("object_state", plant.get_state_output_port(instance)),
            ("body_poses", plant.get_body_poses_output_port()),
            ("body_velocities", plant.get_body_spatial_velocities_output_port()),
            ("carried", self.pull.get_output_port()),
        ):
            builder.Connect(port, self.seal.GetInputPort(name))
        builder.Connect(
            self.seal.GetOutputPort("spatial_force"), plant.get_applied_spatial_force_input_port()
        )
        self.plant, self.body = plant, body
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_mutable_context()
        self.vacuum(on=True)

    def vacuum(self, *, on):
        context = self.seal.GetMyMutableContextFromRoot(self.context)
        self.seal.GetInputPort("opening").FixValue(context, [-0.05 if on else 0.0])

    def advance(self, t):
        self.simulator.AdvanceTo(t)
        return self

    @property
    def sealed(self):
        context = self.seal.GetMyContextFromRoot(self.context)
        return self.seal.GetOutputPort("state").Eval(context)[0]

    @property
    def position(self):
        context = self.plant.GetMyContextFromRoot(self.context)
        return self.plant.EvalBodyPoseInWorld(context, self.body).translation()

    def reaction(self):
        """Vertical force of the world on the hand [N]."""
        context = self.plant.GetMyContextFromRoot(self.context)
        force = self.plant.get_reaction_forces_output_port().Eval(context)[self.weld]
        frame = self.plant.GetFrameByName("gripper_body").CalcPoseInWorld(context)
        return float((frame.rotation() @ force.translational())[2])

    def breaks_at(self):
        """The wrench at which the lip opens."""
        for k in range(1, 3000):
            if k * STEP > 0.1 and self.advance(k * STEP).sealed == 0.0:
                return self.pull.at(k * STEP)
        raise AssertionError("the seal never broke")


def test_a_sealed_object_hangs_still_and_its_weight_on_the_hand(tmp_path):
    dut = Hanging(tmp_path)
    dut.advance(0.5)
    before, with_object = dut.position, dut.reaction()
    assert dut.sealed == 1.0
    np.testing.assert_allclose(dut.advance(1.0).position, before, atol=5e-5)
    dut.vacuum(on=False)
    dut.advance(1.3)
    assert dut.sealed == 0.0
    assert dut.position[2] < before[2] - 0.3
    assert abs(with_object - dut.reaction()) == pytest.approx(MASS * G, rel=0.02)


@pytest.mark.parametrize(
    ("per_second", "entry", "expected"),
    [
        ([0, 0, 0, 0, 0, -30], 5, CUP.vacuum_force - MASS * G),
        ([0, 0, 0, 12, 0, 0], 3, (CUP.vacuum_force - MASS * G) * CUP.radius / SIDE),
        (
            [0, 0, 0.3, 0, 0, 0],
            2,
            (CUP.vacuum_force - MASS * G) * CUP.friction * CUP.radius,
        ),
    ],
    ids=["pull", "bending", "torsion"],
)
def test_the_seal_breaks_at_the_cups_limit(tmp_path, per_second, entry, expected):
    """Area times pressure less the weight; the same at a lever of half a side; friction."""
    dut = Hanging(tmp_path, per_second=per_second)
    assert abs(dut.breaks_at()[entry]) == pytest.approx(expected, rel=0.06)
    t = dut.context.get_time()
    dut.advance(t + 0.3)
    assert dut.sealed == 0.0  # it does not close again by itself
    assert dut.position[2] < 0.4


@pytest.mark.parametrize(
    ("mesh", "drop"),
    [
        (
            trimesh.creation.cylinder(0.03, 0.1).apply_transform(
                trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
            ),
            0.0,
        ),
        (trimesh.creation.annulus(0.006, 0.03, 0.05), 0.0),
        (BOX, 0.004),
    ],
    ids=["curved", "hole", "apart"],
)
def test_no_seal_where_the_lip_does_not_close(tmp_path, mesh, drop):
    dut = Hanging(tmp_path, mesh, drop=drop).advance(0.3)
    assert dut.sealed == 0.0
    assert dut.position[2] < 0.3


def test_a_moving_box_is_held_by_suction():
    scenario = seeded("ReachCircularMocap", "small_box", "task")
    scenario.gripper, scenario.grasp.shake_time, scenario.grasp.hold_time = "suction", 0.0, 0.5
    result = run(scenario, "ReachCircularMocap", log=False)
    x = dict(zip(SAMPLE_NAMES, result.samples, strict=True))
    assert x["phase"][-1] == 5, result.cause
    held = x["phase"] >= 2
    assert result.record["metrics"]["lift_cm"] > 8.0
    for axis in "xyz":
        assert np.ptp(x[f"p_HO_{axis}"][held]) < 0.002


def test_no_place_for_the_cup_is_said_in_words():
    scenario = seeded("ReachCircularMocap", "ball", "task")
    scenario.gripper, scenario.simulation_duration = "suction", 1.5
    result = run(scenario, "ReachCircularMocap")
    assert result.record["metrics"]["cause"] == "no_grasp"
    words = [status.detail for status in result.status]
    assert any("not flat enough for the cup" in each for each in words), words


def test_hardware_has_no_driver_of_a_cup():
    scenario = seeded("ReachCircularMocap", "small_box", "task")
    scenario.gripper = "suction"
    with pytest.raises(ScenarioError, match="no driver of a suction cup"):
        HardwareStation(scenario, DrakeLcm("memq://"), DrakeLcm("memq://"))
