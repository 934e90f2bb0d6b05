"""The robot cell's files against a closed form, the data sheet and a short simulation."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Box, ProximityProperties, Role
from pydrake.geometry import AddContactMaterial, AddRigidHydroelasticProperties
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import JacobianWrtVariable, PdControllerGains, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from feasigrasp.models.gripper import ParallelGripper
from feasigrasp.models.iiwa_capsules import TUBE_RADIUS, arm_capsules
from feasigrasp.resources import model_path

HOME = np.array([0, -0.846, 0, -1.582, 0, 1.446, 0])
# Standard Denavit-Hartenberg table of a spherical-rotational-spherical arm (a = 0 throughout).
DH_ALPHA = np.deg2rad([-90, 90, 90, -90, -90, 90, 0])
DH_D = [0.34, 0.0, 0.40, 0.0, 0.40, 0.0, 0.126]


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


def dh_frames(q):
    """Poses of the eight DH frames in the base, the last one being the flange."""
    X = [np.eye(4)]
    for theta, alpha, d in zip(q, DH_ALPHA, DH_D, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        step = [[ct, -st * ca, st * sa, 0], [st, ct * ca, -ct * sa, 0], [0, sa, ca, d]]
        X.append(X[-1] @ np.array([*step, [0, 0, 0, 1]]))
    return X


def test_kinematics_equal_denavit_hartenberg(plant):
    arm = plant.GetModelInstanceByName("iiwa")
    flange = plant.GetFrameByName("iiwa_flange", arm)
    first = plant.GetJointByName("iiwa_joint_1").velocity_start()
    for q in np.random.default_rng(0).uniform(-2.9, 2.9, (50, 7)):
        context = at(plant, q)
        X = dh_frames(q)
        X_WF = flange.CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(X_WF, X[-1], rtol=0, atol=1e-9)
        J = plant.CalcJacobianSpatialVelocity(
            context,
            JacobianWrtVariable.kV,
            flange,
            np.zeros(3),
            plant.world_frame(),
            plant.world_frame(),
        )[:, first : first + 7]
        axes = np.stack([x[:3, 2] for x in X[:-1]])
        arms = np.stack([X[-1][:3, 3] - x[:3, 3] for x in X[:-1]])
        expected = np.concatenate([axes.T, np.cross(axes, arms).T])
        np.testing.assert_allclose(J, expected, rtol=0, atol=1e-9)


def test_limits_equal_the_data_sheet(plant):
    position = [170, 120, 170, 120, 170, 120, 175]
    velocity = [98, 98, 100, 130, 140, 180, 180]
    torque = [176, 176, 110, 110, 110, 40, 40]
    acceleration = [8.65, 5.44, 5.69, 11.01, 11.78, 13.76, 13.17]
    for i in range(7):
        joint = plant.GetJointByName(f"iiwa_joint_{i + 1}")
        actuator = plant.GetJointActuatorByName(f"iiwa_joint_{i + 1}")
        assert np.rad2deg(joint.position_upper_limits()[0]) == pytest.approx(position[i])
        assert np.rad2deg(joint.position_lower_limits()[0]) == pytest.approx(-position[i])
        assert np.rad2deg(joint.velocity_upper_limits()[0]) == pytest.approx(velocity[i])
        assert joint.acceleration_upper_limits()[0] == pytest.approx(acceleration[i])
        assert actuator.effort_limit() == torque[i]
        assert actuator.default_gear_ratio() == 160
        assert 5e-5 < actuator.default_rotor_inertia() < 2e-4


def test_masses_and_inertias(plant):
    arm = plant.GetModelInstanceByName("iiwa")
    context = at(plant, np.zeros(7))
    assert plant.CalcTotalMass(context, [arm]) == pytest.approx(23.9, abs=1e-3)
    hand = [plant.GetModelInstanceByName(name) for name in ("gripper", "camera")]
    assert plant.CalcTotalMass(context, hand[:1]) == pytest.approx(0.34 + 0.05)
    assert plant.CalcTotalMass(context, hand[1:]) == pytest.approx(0.072)
    for instance in (arm, *hand):
        for index in plant.GetBodyIndices(instance):
            body = plant.get_body(index)
            inertia = body.CalcSpatialInertiaInBodyFrame(context)
            assert inertia.IsPhysicallyValid()
            assert inertia.get_mass() > 0.03
            central = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
            moments = np.sort(central.CalcPrincipalMomentsOfInertia())
            assert 0 < moments[0] and moments[2] < moments[0] + moments[1]
    # The bulges alternate: each link's centre of mass lies on the side of its drum.
    sides = [
        np.sign(plant.GetBodyByName(f"iiwa_link_{i}").default_com()[1].round(3)) for i in range(6)
    ]
    assert sides == [0, -1, 1, 1, -1, -1]


def test_files_equal_the_generator(tmp_path):
    script = model_path("iiwa", "make_models.py")
    subprocess.run(
        [sys.executable, str(script), "--output", str(tmp_path)],
        check=True,
        env={"PYTHONPATH": str(model_path().parent), "PATH": ""},
    )
    written = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    folder = script.parent
    kept = [p for p in folder.rglob("*") if p.suffix in (".urdf", ".yaml", ".gltf")]
    assert written == sorted(p.relative_to(folder) for p in kept)
    for path in written:
        same = (tmp_path / path).read_bytes() == (folder / path).read_bytes()
        assert same, f"{path} is stale; run python models/iiwa/make_models.py"


def test_housings_stay_close_to_their_capsules():
    """What is seen and what is checked for collision differ by 2 cm at most, at edges."""
    for index in range(8):
        scene = trimesh.load(model_path("iiwa", "meshes", f"link_{index}.gltf"), process=False)
        points = scene.to_mesh().vertices[:, [0, 2, 1]] * [1, -1, 1]  # glTF is y up
        outside = np.full(len(points), np.inf)
        for capsule in arm_capsules():
            if capsule.body == index:
                a, b = np.array(capsule.a), np.array(capsule.b)
                t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
                d = np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)
                outside = np.minimum(outside, d - capsule.radius)
        assert np.quantile(outside, 0.9) < 0.008
        # The base's connector, towards the back, is out of the arm's reach.
        assert outside[points[:, 0] > -TUBE_RADIUS - 0.01].max() < 0.02


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


def test_home_is_free_of_contact():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.002), builder)
    load_cell(plant)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant.SetPositions(
        plant.GetMyMutableContextFromRoot(context), plant.GetModelInstanceByName("iiwa"), HOME
    )
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    assert not query.ComputePointPairPenetration()
    inspector = query.inspector()
    assert len(inspector.GetAllGeometryIds(Role.kPerception)) >= 15


def test_directives_for_the_arm_of_drake_models(plant):
    """The variant's structure with our arm in place of the one that must be downloaded."""
    text = model_path("iiwa", "cell_drake_models.dmd.yaml").read_text()
    uri = "package://drake_models/iiwa_description/sdf/iiwa7_with_box_collision.sdf"
    assert uri in text
    text = text.replace(uri, "package://feasigrasp/iiwa/iiwa7.urdf")
    text = text.replace("iiwa::iiwa_flange", "iiwa::flange")  # ours has one of that name already
    other = MultibodyPlant(0.002)
    parser = Parser(other)
    parser.package_map().Add("feasigrasp", str(model_path()))
    directives = __import__("pydrake.common.yaml", fromlist=["x"]).yaml_load_typed(
        schema=ModelDirectives, data=text
    )
    ProcessModelDirectives(directives, parser)
    other.Finalize()
    flange = other.GetFrameByName("flange", other.GetModelInstanceByName("iiwa"))
    for q in (np.zeros(7), HOME):
        theirs, ours = at(other, q), at(plant, q)
        for frame in ("grasp_frame", "camera_optical"):
            X, Y = (
                p.GetFrameByName(frame).CalcPoseInWorld(c)
                for p, c in ((other, theirs), (plant, ours))
            )
            assert X.IsNearlyEqualTo(Y, 1e-9)
        X_WF = flange.CalcPoseInWorld(theirs).GetAsMatrix4()
        np.testing.assert_allclose(X_WF, dh_frames(q)[-1], atol=1e-9)
