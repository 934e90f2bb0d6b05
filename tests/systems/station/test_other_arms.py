import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

import feasigrasp as fg
from feasigrasp.errors import ScenarioError
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm_file import arm_names, load_arm
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.runs.metrics.reference_robot import reference_robot, self_collision_metrics
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.cell_check import check_cell
from feasigrasp.systems.station.directives import cell_directives

OTHERS = [name for name in arm_names() if name != "iiwa7"]


def scenario_with(name):
    scenario = fg.load_scenario("ReachLinearMocap")
    scenario.arm, scenario.cameras = name, {}
    return scenario


@pytest.mark.parametrize("name", OTHERS)
def test_the_cell_of_another_arm_is_what_is_computed_with(name):
    arm, scenario = load_arm(name), scenario_with(name)
    station = make_station(scenario)
    check_cell(station.plant, ParallelGripper(), arm)
    with pytest.raises(ScenarioError, match="no model named 'iiwa'"):
        check_cell(station.plant, ParallelGripper())
    plant = station.plant
    context, instance = plant.CreateDefaultContext(), plant.GetModelInstanceByName(arm.name)
    np.testing.assert_allclose(plant.GetPositions(context, instance), arm.home)
    flange = plant.GetFrameByName(f"{arm.name}_flange")
    start = plant.GetJointByName(arm.joint_names[0]).velocity_start()
    for q in arm.random_positions(np.random.default_rng(0), 5):
        plant.SetPositions(context, instance, q)
        X, J = pose_and_jacobian(q, None, arm)
        np.testing.assert_allclose(flange.CalcPoseInWorld(context).GetAsMatrix4(), X, atol=1e-9)
        W, kind = plant.world_frame(), JacobianWrtVariable.kV
        theirs = plant.CalcJacobianSpatialVelocity(context, kind, flange, np.zeros(3), W, W)
        np.testing.assert_allclose(theirs[:, start : start + arm.joints], J, atol=1e-9)


@pytest.mark.parametrize("name", OTHERS)
def test_collisions_of_another_arm_are_those_of_its_capsules(name):
    arm = load_arm(name)
    reference = reference_robot(cell_directives(scenario_with(name)), arm)
    assert self_collision_metrics(reference, arm.home[None])["self_collision_percent"] == 0.0
    Q = arm.random_positions(np.random.default_rng(1), 100)
    assert 0.0 < self_collision_metrics(reference, Q)["self_collision_percent"] < 80.0


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_admissible_does_not_collide_in_the_simulation(name):
    arm = load_arm(name)
    station = make_station(scenario_with(name))
    plant, root = station.plant, station.CreateDefaultContext()
    context, instance = plant.GetMyContextFromRoot(root), plant.GetModelInstanceByName(arm.name)
    query, inspector = station.scene_graph.get_query_output_port(), station.scene_graph
    Q = arm.random_positions(np.random.default_rng(0), 1000)
    Q = Q[Reachability(arm=arm).admissible(Q)]
    assert len(Q) > 20
    for q in Q:
        plant.SetPositions(context, instance, q)
        found = query.Eval(station.scene_graph.GetMyContextFromRoot(root))
        for pair in found.ComputePointPairPenetration():
            names = {
                plant.GetBodyFromFrameId(inspector.model_inspector().GetFrameId(each)).name()
                for each in (pair.id_A, pair.id_B)
            }
            assert "object" in names, names


def test_joint_positions_at_the_start_are_those_of_the_arm():
    for name in OTHERS:
        scenario = fg.load_scenario("ReachLinearMocap", f"{{arm: {name}}}")
        np.testing.assert_array_equal(scenario.start, load_arm(name).home)
    with pytest.raises(ScenarioError, match="q_start has 7 entries; .* 6"):
        fg.load_scenario("ReachLinearMocap", "{arm: ur5e, q_start: [0, 0, 0, 0, 0, 0, 0]}")


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_another_arm_follows_grasps_and_holds(name):
    """One of each closed form of the inverse kinematics beside that of the default arm."""
    grasp = "{shake_time: 0.7, hold_time: 1.0}"
    text = f"{{arm: {name}, random_seed: 1, grasp: {grasp}}}"
    scenario = fg.load_scenario("ReachLinearMocap", text)
    result = fg.run(scenario, log=False)
    assert result.held
    for what in ("joint_limit", "velocity_limit", "acceleration_limit"):
        assert result.metrics[f"{what}_violation_percent"] == 0.0
    assert result.metrics["self_collision_percent"] == 0.0


def test_ports_are_found_by_their_former_names_too():
    station = make_station(scenario_with("ur5e"))
    for get, port in (
        (station.GetInputPort, "desired_state"),
        (station.GetOutputPort, "state_estimated"),
    ):
        with pytest.warns(FutureWarning, match=f"iiwa.{port} is now arm.{port}"):
            former = get(f"iiwa.{port}")
        assert former.get_index() == get(f"arm.{port}").get_index()


def test_packaged_motions_shrink_with_the_reach_of_a_smaller_arm():
    motion = fg.load_scenario("ReachLinearMocap").motion
    assert motion.center == [0.5, 0.0, 0.55]
    assert fg.load_scenario("ReachLinearMocap", "{arm: iiwa14}").motion.center == motion.center
    share = load_arm("xarm7").reach / load_arm("iiwa7").reach
    assert 0.7 < share < 0.95
    shrunk = fg.load_scenario("ReachLinearMocap", "{arm: xarm7}").motion
    assert shrunk.center == [0.5 * share, 0.0, 0.55]
    np.testing.assert_allclose(shrunk.amplitude, share * np.array(motion.amplitude))
    given = "{arm: xarm7, motion: {center: [0.45, 0.0, 0.5]}}"
    assert fg.load_scenario("ReachLinearMocap", given).motion.center == [0.45, 0.0, 0.5]
