"""The measured contact force against statics: what carries an object carries its weight."""

import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    Box,
    ProximityProperties,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlantConfig,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.systems.station.object_contact import ObjectContact
from feasigrasp.systems.station.object_model import add_object

DT = 0.002
BOX = 0.2
DROP = 0.02


def _add_hand(plant, *, compliant):
    """A box whose top is at z = 0."""
    hand = plant.AddModelInstance("gripper")
    palm = plant.AddRigidBody("palm", hand)
    plant.WeldFrames(plant.world_frame(), palm.body_frame())
    properties = ProximityProperties()
    if compliant:
        AddCompliantHydroelasticProperties(0.05, 1e7, properties)
    AddContactMaterial(friction=CoulombFriction(0.8, 0.8), dissipation=20.0, properties=properties)
    plant.RegisterCollisionGeometry(
        palm, RigidTransform([0, 0, -0.5 * BOX]), Box(BOX, BOX, BOX), "top", properties
    )
    return hand


class Resting:
    """An object that drops by `DROP` onto a box, which belongs to the robot or does not."""

    def __init__(self, folder, *, compliant, robot, hand_first=False):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=DT,
            contact_model="hydroelastic_with_fallback",
            use_sampled_output_ports=False,
            discrete_contact_approximation="lagged",
        )
        self.plant, _ = plant, _ = AddMultibodyPlant(config, builder)
        self.obj = load_object("soup_can")
        if hand_first:  # the order decides which body a contact names first
            hand = _add_hand(plant, compliant=compliant)
        body = plant.GetBodyByName("object", add_object(plant, self.obj, directory=folder))
        if not hand_first:
            hand = _add_hand(plant, compliant=compliant)
        bottom = self.obj.vertices[:, 2].min()
        plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform([0, 0, DROP - bottom]))
        plant.Finalize()
        self.dut = builder.AddSystem(ObjectContact(plant, body.index(), [hand] if robot else []))
        builder.Connect(
            plant.get_contact_results_output_port(), self.dut.GetInputPort("contact_results")
        )
        builder.ExportInput(self.dut.GetInputPort("phase"), "phase")
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.set_phase(Phase.APPROACH)

    def set_phase(self, phase):
        self.diagram.GetInputPort("phase").FixValue(self.context, [float(phase)])

    def advance(self, t):
        """Time of the approach, of contact in it, the peak force and the impulse."""
        self.simulator.AdvanceTo(t)
        return self.dut.get_output_port().Eval(self.dut.GetMyContextFromRoot(self.context))

    def results(self):
        context = self.plant.GetMyContextFromRoot(self.context)
        return self.plant.get_contact_results_output_port().Eval(context)

    def touches(self):
        return self.dut.touches(self.results())

    def force(self):
        return self.dut.force(self.results())


def test_ports_are_those_of_the_docstring(tmp_path, ports, documented_ports):
    inputs, outputs = ports(Resting(tmp_path, compliant=True, robot=True).dut)
    assert (list(inputs), list(outputs)) == documented_ports(ObjectContact)
    assert (inputs["phase"], outputs["approach"]) == (1, 4)


@pytest.mark.parametrize("hand_first", [True, False])
@pytest.mark.parametrize("compliant", [True, False], ids=["hydroelastic", "points"])
def test_it_is_the_weight_of_what_rests_on_the_hand(tmp_path, compliant, hand_first):
    resting = Resting(tmp_path, compliant=compliant, robot=True, hand_first=hand_first)
    landing = np.sqrt(2.0 * DROP / 9.81)
    before = resting.advance(landing - 0.01).copy()
    np.testing.assert_allclose(before, [landing - 0.01, 0.0, 0.0, 0.0], atol=1.5 * DT)
    assert not resting.touches()
    weight = resting.obj.mass * 9.81
    time, touched, peak, impulse = resting.advance(1.0)
    assert resting.touches()
    force = resting.force()
    assert force[2] == pytest.approx(weight, rel=0.01 if compliant else 0.3)
    if compliant:  # on a single point it rocks
        np.testing.assert_allclose(force[:2], 0.0, atol=0.01 * weight)
    assert time == pytest.approx(1.0, abs=1.5 * DT)
    assert 0.5 * (1.0 - landing) < touched < 1.0 - landing + 2 * DT  # it may bounce
    assert peak > weight  # it fell
    # It begins and ends at rest: the contact has taken up the impulse of the weight.
    assert impulse == pytest.approx(weight * 1.0, rel=0.02 if compliant else 0.1)


@pytest.mark.parametrize("hand_first", [True, False])
@pytest.mark.parametrize("compliant", [True, False], ids=["hydroelastic", "points"])
def test_contact_with_others_does_not_count(tmp_path, compliant, hand_first):
    resting = Resting(tmp_path, compliant=compliant, robot=False, hand_first=hand_first)
    np.testing.assert_allclose(resting.advance(0.5), [0.5, 0.0, 0.0, 0.0], atol=1.5 * DT)
    assert not resting.touches()
    assert np.linalg.norm(resting.force()) == 0.0


def test_only_the_approach_counts(tmp_path):
    resting = Resting(tmp_path, compliant=True, robot=True)
    resting.advance(0.04)
    resting.set_phase(Phase.CLOSE)
    np.testing.assert_allclose(resting.advance(0.5), [0.04, 0.0, 0.0, 0.0], atol=1.5 * DT)
    assert resting.touches()
