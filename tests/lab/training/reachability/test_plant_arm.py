"""An arm taken out of a model file against Drake's own kinematics and collision queries."""

import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import model_path
from feasigrasp_lab.training.reachability.plant_arm import PlantArm

URDF = Path(__file__).with_name("six_axis_arm.urdf")


@pytest.fixture(scope="module")
def arm() -> PlantArm:
    return PlantArm(URDF, "base", "tool")


@pytest.fixture(scope="module")
def drake():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModels(str(URDF))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    return plant, plant.GetMyContextFromRoot(context)


def draws(arm, n):
    return np.random.default_rng(2).uniform(arm.lower, arm.upper, (n, len(arm.lower)))


def test_chain_is_drakes(arm, drake):
    plant, context = drake
    np.testing.assert_array_equal(arm.lower, plant.GetPositionLowerLimits())
    np.testing.assert_array_equal(arm.upper, plant.GetPositionUpperLimits())
    world, tool = plant.world_frame(), plant.GetFrameByName("tool")
    q = draws(arm, 30)
    poses, jacobians = arm.chain.pose_and_jacobian(q)
    for q_k, X, J in zip(q, poses, jacobians, strict=True):
        plant.SetPositions(context, q_k)
        np.testing.assert_allclose(X, tool.CalcPoseInWorld(context).GetAsMatrix4(), atol=1e-13)
        expected = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, tool, np.zeros(3), world, world
        )
        np.testing.assert_allclose(J, expected, atol=1e-13)
    expected = np.sqrt(np.linalg.det(jacobians @ jacobians.swapaxes(1, 2)))
    np.testing.assert_allclose(arm.manipulability(q), expected)


def test_collisions_are_drakes(arm, drake):
    plant, context = drake
    q = draws(arm, 400)
    expected = []
    for q_k in q:
        plant.SetPositions(context, q_k)
        query = plant.get_geometry_query_input_port().Eval(context)
        expected.append(query.HasCollisions())
    assert 0.02 < np.mean(expected) < 0.9
    np.testing.assert_array_equal(arm.in_collision(q), expected)


def test_a_base_frame_inside_the_arm(arm):
    forearm = PlantArm(URDF, "turret", "hand")
    q = draws(arm, 5)
    turret = PlantArm(URDF, "base", "turret").forward_kinematics(q[:, :1])
    hand = PlantArm(URDF, "base", "hand").forward_kinematics(q)
    np.testing.assert_allclose(turret @ forearm.forward_kinematics(q[:, 1:]), hand, atol=1e-13)


def test_our_own_arm_from_its_directives_is_the_closed_form():
    arm = PlantArm(model_path("iiwa", "cell.dmd.yaml"), "iiwa_link_0", "iiwa_flange")
    q = draws(arm, 10)
    np.testing.assert_allclose(arm.forward_kinematics(q), forward_kinematics(q), atol=1e-12)


@pytest.mark.parametrize(
    ("filename", "base", "end", "message"),
    [
        ("missing.urdf", "base", "tool", "no such file"),
        (URDF, "bse", "tool", "no frame 'bse'"),
        (URDF, "tool", "base", "no chain of joints"),
        (URDF, "hand", "tool", "nothing moves"),
    ],
)
def test_bad_input_is_named(filename, base, end, message):
    with pytest.raises(ReachabilityError, match=message):
        PlantArm(filename, base, end)


def test_a_file_that_is_no_model_is_named(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("<robot name='x'>")
    with pytest.raises(ReachabilityError, match="cannot read"):
        PlantArm(path, "base", "tool")


def test_endless_joints_need_limits(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(re.sub('lower="[^"]*" upper="[^"]*"', "", URDF.read_text()))
    with pytest.raises(ReachabilityError, match="joint 0 has limits"):
        PlantArm(path, "base", "tool")
