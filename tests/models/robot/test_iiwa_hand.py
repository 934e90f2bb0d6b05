"""The gripper and the wrist camera: frames, mounting, and a simulation of the fingers."""

import numpy as np
import pytest
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import PdControllerGains, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.resources import model_path

HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])


def load_cell(plant):
    parser = Parser(plant)
    parser.package_map().Add("feasigrasp", str(model_path()))
    parser.AddModels(str(model_path("iiwa", "cell.dmd.yaml")))


@pytest.fixture(scope="module")
def plant():
    plant = MultibodyPlant(0.002)
    load_cell(plant)
    plant.Finalize()
    return plant


def at(plant, q):
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, plant.GetModelInstanceByName("iiwa"), q)
    return context


def simulate_gripper(command, seconds, box_width=None):
    """Final finger positions, and the force on each finger along the closing direction [N]."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=0.002, discrete_contact_approximation="lagged"), builder
    )
    load_cell(plant)
    arm, gripper = (plant.GetModelInstanceByName(name) for name in ("iiwa", "gripper"))
    if box_width is not None:
        inertia = SpatialInertia.SolidBoxWithMass(0.2, box_width, 0.04, 0.08)
        body = plant.AddRigidBody("box", plant.AddModelInstance("box"), inertia)
        properties = ProximityProperties()
        AddContactMaterial(friction=CoulombFriction(0.8, 0.8), properties=properties)
        AddRigidHydroelasticProperties(0.04, properties)
        shape = Box(box_width, 0.04, 0.08)
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, "box", properties)
    plant.Finalize()
    (index,) = plant.GetJointActuatorIndices(gripper)
    plant.get_joint_actuator(index).set_controller_gains(PdControllerGains(p=1e5, d=500.0))
    source = builder.AddSystem(ConstantVectorSource([command, 0.0]))
    builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(gripper))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, arm, HOME)
    for index in plant.GetJointIndices(arm):
        if plant.get_joint(index).num_velocities():
            plant.get_joint(index).Lock(context)
    grasp = plant.GetFrameByName("grasp_frame")
    if box_width is not None:
        plant.SetPositions(context, gripper, [0.9 * ParallelGripper().max_opening / 2] * 2)
        plant.SetFreeBodyPose(context, body, grasp.CalcPoseInWorld(context))
    history = []
    simulator.set_monitor(lambda _: history.append(plant.GetPositions(context, gripper)))
    simulator.AdvanceTo(seconds)
    R_WG = grasp.CalcPoseInWorld(context).rotation()
    fingers = {plant.GetBodyByName(f"{side}_finger").index(): side for side in ("left", "right")}
    results = plant.get_contact_results_output_port().Eval(context)
    force = dict.fromkeys(("left", "right"), 0.0)
    inspector = plant.get_geometry_query_input_port().Eval(context).inspector()
    for k in range(results.num_hydroelastic_contacts()):
        info = results.hydroelastic_contact_info(k)
        surface = info.contact_surface()
        for geometry, sign in ((surface.id_M(), 1), (surface.id_N(), -1)):
            frame = inspector.GetFrameId(geometry)
            side = fingers.get(plant.GetBodyFromFrameId(frame).index())
            if side is not None:
                force[side] += sign * (R_WG.inverse() @ info.F_Ac_W().translational())[0]
    return np.array(history), force


def test_gripper_opens_and_closes_symmetrically():
    opening = ParallelGripper().max_opening / 2
    opened, _ = simulate_gripper(opening, 0.3)
    assert np.abs(opened[-1] - opening).max() < 5e-4
    closed, _ = simulate_gripper(0.0, 0.1)
    assert np.abs(closed[-1]).max() < 5e-4
    # The mimic joint is a stiff constraint, not an exact one.
    for history in (opened, closed):
        assert np.abs(history[:, 0] - history[:, 1]).max() < 2e-4


def test_both_fingers_share_the_force():
    """The effort limit of 80 N reaches a box in the hand as 40 N from either side."""
    history, force = simulate_gripper(0.0, 0.4, box_width=0.05)
    np.testing.assert_allclose(history[-1], 0.025, atol=5e-4)
    assert force["left"] == pytest.approx(40.0, abs=2.0)
    assert force["right"] == pytest.approx(-40.0, abs=2.0)


def test_frames_of_the_hand(plant):
    gripper = ParallelGripper()
    context = at(plant, np.zeros(7))
    flange, grasp, optical = (
        plant.GetFrameByName(name) for name in ("iiwa_flange", "grasp_frame", "camera_optical")
    )
    X_FG = grasp.CalcPose(context, flange).GetAsMatrix4()
    np.testing.assert_allclose(X_FG, gripper.X_FG, atol=1e-9)
    X_GC = optical.CalcPose(context, grasp)
    axis, eye = X_GC.rotation().col(2), X_GC.translation()
    # The optical axis lies in the hand's middle plane, leans by 15 degrees and crosses the
    # approach axis in front of the finger tips.
    assert np.rad2deg(np.arccos(axis[2])) == pytest.approx(15.0)
    assert abs(eye[0]) < 1e-9 and abs(axis[0]) < 1e-9
    crossing = eye - axis * eye[1] / axis[1]
    assert gripper.tip + 0.05 < crossing[2] < 0.4
    # The pad centre is in view (64 degrees high) and the palm's edge does not hide it.
    below = np.arccos(-axis @ eye / np.linalg.norm(eye))
    assert np.rad2deg(below) < 31.9
    at_palm = eye * gripper.heel / eye[2]
    assert at_palm[1] > gripper.palm_size[1] / 2


def test_the_camera_box_of_the_gripper_holds_the_camera(plant):
    gripper = ParallelGripper()
    context = at(plant, np.zeros(7))
    X_GC = plant.GetFrameByName("camera_body").CalcPose(
        context, plant.GetFrameByName("grasp_frame")
    )
    corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * (0.090, 0.025, 0.025)
    inside = np.abs((X_GC @ corners.T).T - gripper.camera_center).max(axis=0)
    assert (inside <= np.array(gripper.camera_box) / 2 + 1e-9).all()
    assert (inside > np.array(gripper.camera_box) / 2 - 1e-3).all()


def test_the_image_is_upright_at_home(plant):
    X_WC = plant.GetFrameByName("camera_optical").CalcPoseInWorld(at(plant, HOME))
    right, down, forward = X_WC.rotation().matrix().T
    np.testing.assert_allclose(right, [0, -1, 0], atol=1e-9)
    assert down[2] < -0.5
    assert forward[0] > 0.5 and forward[2] < 0


def test_the_pad_mesh_fills_the_pad():
    gripper = ParallelGripper()
    lines = model_path("iiwa", "meshes", "pad.vtk").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("POINTS")) + 1
    points = np.array([line.split() for line in lines[first : first + 9]], dtype=float)
    cells = np.array([line.split()[1:] for line in lines if line.startswith("4 ")], dtype=int)
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    volumes = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(0.006 * gripper.finger_width * 2 * gripper.tip)
