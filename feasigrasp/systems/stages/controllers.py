"""Makes reachability filter, controller and drive of a scenario."""

from pydrake.systems.framework import LeafSystem

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import ControlSpace, controller_names, parse_word
from feasigrasp.models.control.horizon.law import HorizonOptions
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.reach.interception import InterceptionOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.plugins import load_plugin
from feasigrasp.scenario.modes import added_mode
from feasigrasp.scenario.schema import EXACT, Scenario
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp.systems.reachability_filter import ReachabilityFilter
from feasigrasp.systems.velocity_drive import VelocityDrive


def make_reachability(scenario: Scenario) -> Reachability:
    """Reachability of a scenario's arm, with its hand above its table."""
    cell, ours = scenario.cell, Reachability.table_clearance - SafetyOptions.table_clearance
    return Reachability(
        load_gripper(scenario.gripper),
        arm=load_arm(scenario.arm),
        table_clearance=cell.table_clearance + ours,
        table_height=cell.table_height,
    )


def make_reachability_filter(scenario: Scenario, reachability: Reachability) -> LeafSystem:
    """The reachability filter of a scenario."""
    config = scenario.reachability
    if config.method != EXACT:
        return load_plugin("judges", config.method)(scenario, reachability)
    return ReachabilityFilter(
        reachability,
        options=_interception(scenario),
        prediction=scenario.control.prediction,
        symmetric_grasps=config.symmetric_grasps,
        period=config.period,
    )


def make_controller(scenario: Scenario, reachability: Reachability) -> GraspController:
    """The controller of a scenario."""
    config, arm = scenario.control, reachability.arm
    fastest = config.speed * SafetyOptions.velocity_scale
    most = arm.braking_rate(fastest, arm.acceleration_share)
    safety = SafetyOptions(
        approach_gain=min(SafetyOptions.approach_gain, most),
        period=config.period,
        speed=config.speed,
        table_height=reachability.table_height,
        table_clearance=scenario.cell.table_clearance,
        acceleration_scale=arm.acceleration_share,
        position_margin=arm.position_margin,
        arm=arm,
    )
    name = parse_word(controller_names(), config.controller, "control.controller", ScenarioError)
    if name not in [*ControlSpace]:
        return load_plugin("controllers", name)(scenario, reachability, safety)
    mode = added_mode(config.mode)
    if mode is not None:
        return mode.make_controller(scenario, reachability)
    options = HorizonOptions(
        prediction=config.prediction,
        neighbours=HorizonOptions.neighbours if config.density else 1,
        rank_period=scenario.reachability.period,
        corridor=ApproachCorridor(min_standoff=scenario.grasp.standoff),
        interception=_interception(scenario),
        program=ProgramOptions(safety=safety),
    )
    kind = GPJointController if config.controller == ControlSpace.JOINT else RMMTaskController
    return kind(reachability, options)


def _interception(scenario: Scenario) -> InterceptionOptions:
    """What can be followed at the arm's speed, scores counted if the scenario says so."""
    config, default = scenario.control, InterceptionOptions
    x, y, z = scenario.grasp.lift if scenario.grasp.close else default.lift
    return InterceptionOptions(
        velocity=config.speed * default.velocity,
        score=default.score if config.score else 0.0,
        lift=(x, y, z),
    )


def make_drive(scenario: Scenario) -> LeafSystem:
    """The drive between the controller's velocity and the arm."""
    config = scenario.control
    if mode := added_mode(config.mode):
        return mode.make_drive(scenario)
    return VelocityDrive(config.period, speed=config.speed, arm=load_arm(scenario.arm))
