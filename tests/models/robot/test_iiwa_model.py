"""The robot cell's files against a closed form, the data sheet and a short simulation."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.common.yaml import yaml_load_typed
from pydrake.geometry import (
    Role,
)
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

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
            assert moments[0] > 0 and moments[2] < moments[0] + moments[1]
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
    kept = [p for p in folder.rglob("*") if p.suffix in (".urdf", ".yaml", ".gltf", ".vtk")]
    assert written == sorted(p.relative_to(folder) for p in kept)
    for path in written:
        same = (tmp_path / path).read_bytes() == (folder / path).read_bytes()
        assert same, f"{path} is stale; run python models/iiwa/make_models.py"


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


def test_every_body_is_seen_as_one_primitive():
    """Renderers move every visual, and every primitive of it, at every step."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=0.002), builder)
    load_cell(plant)
    inspector = scene_graph.model_inspector()
    shapes = [inspector.GetShape(g) for g in inspector.GetAllGeometryIds(Role.kPerception)]
    assert len(shapes) == plant.num_bodies() - 1  # all but the world
    for shape in shapes:
        document = json.loads(Path(shape.source().path()).read_text())
        assert [len(mesh["primitives"]) for mesh in document["meshes"]] == [1]


def test_the_palette_colours_the_parts_of_a_mesh():
    """A black pad, a silver bone and an orange stripe, one behind the other along x."""
    mesh = trimesh.load(model_path("iiwa", "meshes", "left_finger.gltf"), process=False).to_mesh()
    x, color = mesh.vertices[:, 0], mesh.visual.to_color().vertex_colors[:, :3]
    assert (color[x < 0.0059] < 30).all()
    assert (color[(x > 0.0061) & (x < 0.0143)] > 220).all()
    assert (np.abs(color[x > 0.0151].astype(int) - (255, 162, 0)) <= 1).all()


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
    ProcessModelDirectives(yaml_load_typed(schema=ModelDirectives, data=text), parser)
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
