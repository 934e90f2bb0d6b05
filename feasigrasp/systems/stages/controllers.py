"""Makes reachability filter, controller and drive of a scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from pydrake.systems.framework import LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import ControlSpace, controller_names, parse_word
from feasigrasp.models.control.joint.law import JointControlOptions
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.control.planning.static_grid import static_grid
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.control.task.pursuit import PursuitOptions
from feasigrasp.models.control.task.safe_law import TaskControlOptions
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.reach.predicted_reachability import WAY_IN, Judge
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper import load_gripper
from feasigrasp.plugins import load_plugin
from feasigrasp.scenario.modes import added_mode
from feasigrasp.scenario.sampling import (
    make_static_obstacles,
)
from feasigrasp.scenario.schema import CLOSED_FORM, EXACT, ControlConfig, Scenario
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.reachability_filter import ReachabilityFilter
from feasigrasp.systems.rmm_task_controller import RMMTaskController
from feasigrasp.systems.velocity_drive import VelocityDrive


def make_reachability(scenario: Scenario) -> Reachability:
    """Reachability of a scenario's arm, with its hand above its table."""
    cell, ours = scenario.cell, Reachability.table_clearance - SafetyOptions.table_clearance
    return Reachability(
        load_gripper(scenario.gripper),
        table_clearance=cell.table_clearance + ours,
        table_height=cell.table_height,
    )


def make_static_grid(scenario: Scenario) -> ObstacleGrid | None:
    """Distances to the boxes and meshes of the scenario's cell; None if it has none.

    Raises:
        ScenarioError: The arm begins in one of them.
        MeshError: A mesh cannot be read, or is flat.
    """
    obstacles = make_static_obstacles(scenario)
    if not obstacles:
        return None
    balls = arm_balls(capsule_model(load_gripper(scenario.gripper)))
    center = balls.placed(np.deg2rad(scenario.q_start))
    for obstacle in obstacles:
        room = float(np.min(obstacle.distance(center) - balls.radius))
        if room < 0.0:
            raise ScenarioError(
                f"the obstacle {obstacle.name} of cell is {-100.0 * room:.1f} cm in the arm at "
                "q_start; move one of them"
            )
    return static_grid(obstacles)


def make_reachability_filter(scenario: Scenario, reachability: Reachability) -> LeafSystem:
    """The reachability filter of a scenario; the paper's modes skip the approach corridor."""
    config = scenario.reachability
    judge: Judge = reachability
    if config.method != EXACT:
        judge = load_plugin("judges", config.method)(scenario, reachability)
        if isinstance(judge, LeafSystem):  # a filter of its own
            return judge
    return ReachabilityFilter(
        judge,
        horizon=config.horizon,
        symmetric_grasps=config.symmetric_grasps,
        way_in=WAY_IN if scenario.control.safe else 0.0,
        period=config.period,
    )


def make_controller(scenario: Scenario, reachability: Reachability) -> GraspController:
    """The controller of a scenario."""
    config, period = scenario.control, scenario.reachability.period
    safety = SafetyOptions(
        period=config.period,
        speed=config.speed,
        table_height=reachability.table_height,
        table_clearance=scenario.cell.table_clearance,
    )
    name = parse_word(controller_names(), config.controller, "control.controller", ScenarioError)
    if name not in [*ControlSpace]:
        make = load_plugin("controllers", name)
        return cast(GraspController, make(scenario, reachability, safety))
    mode = added_mode(config.mode)
    if mode is not None:
        return cast(GraspController, mode.make_controller(scenario, reachability))
    if config.controller == ControlSpace.JOINT:
        solutions = SolutionOptions(n_solutions=config.n_solutions)
        if config.source != CLOSED_FORM:
            solutions = replace(solutions, find=load_plugin("ik_sources", config.source))
        joint_options = JointControlOptions(
            gain=config.gain or JointControlOptions.gain,
            max_speed=config.speed * JointControlOptions.max_speed,
            feed_forward=config.feed_forward,
            solutions=solutions,
            costs=_costs(config, CostWeights.for_joint_field(1.5 if scenario.grasp.close else 3.0)),
            prediction=config.prediction,
            safety=safety,
        )
        way_in = joint_options.corridor._replace(min_standoff=scenario.grasp.standoff)
        joint_options = replace(joint_options, corridor=way_in)
        return GPJointController(reachability, joint_options, period=period)
    costs = CostWeights.to_grasp_soon() if scenario.grasp.close else CostWeights()
    way_in = ApproachCorridor(min_standoff=scenario.grasp.standoff)
    choice = ChoiceOptions(_costs(config, costs), config.prediction, corridor=way_in)
    if not config.density:
        choice = replace(choice, neighbourhood=0.0)
    options = TaskControlOptions(
        gain=config.gain or TaskControlOptions.gain,
        feed_forward=config.feed_forward,
        choice=choice,
        pursuit=PursuitOptions(speed_share=config.speed * PursuitOptions.speed_share),
        safety=safety,
    )
    return RMMTaskController(reachability, options, period=period, seed=scenario.random_seed)


def _costs(config: ControlConfig, costs: CostWeights) -> CostWeights:
    """The prices at the arm's speed, without those that the scenario switches off."""
    return replace(
        costs,
        speed_share=config.speed * costs.speed_share,
        follow_share=config.speed * costs.follow_share,
        regrip_time=costs.regrip_time / config.speed,
        score=costs.score if config.score else 0.0,
        density=costs.density if config.density else 0.0,
    )


def make_drive(scenario: Scenario) -> LeafSystem:
    """The drive between the controller's velocity and the arm."""
    config = scenario.control
    mode = added_mode(config.mode)
    if mode is not None:
        return mode.make_drive(scenario)
    return VelocityDrive(config.period, speed=config.speed)
