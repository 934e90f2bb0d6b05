"""What a guard keeps the arm clear of: itself, its hand, and the cell."""

from typing import NamedTuple

from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.control.safety.driver_clock import SHORTEST
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import make_static_grid
from feasigrasp.systems.hardware import channels


class GuardedCell(NamedTuple):
    """Clearances of a guard, and the arm's speed, in a form that goes to another process.

    The ``obstacles`` are distances to the bodies of the cell, in the frame of the arm's base.
    """

    options: SafetyOptions
    gripper: Gripper
    obstacles: ObstacleGrid | None

    def make_guard(self) -> CommandGuard:
        """A guard of the arm."""
        safety = SafetyFilter(self.options, self.gripper)
        given = self.options.speed, safety, self.obstacles, self.options.arm
        return CommandGuard(channels.IIWA_PERIOD, *given)


def make_guarded_cell(scenario: Scenario) -> GuardedCell:
    """The cell of a scenario, at half the clearances that its controller keeps.

    Bodies are approached as fast as the arm can still brake. So the guard changes hardly anything
    that a controller in mode ``safe`` asks for.
    """
    cell, default, speed = scenario.cell, SafetyOptions, scenario.control.speed
    arm = load_arm(scenario.arm)
    options = SafetyOptions(
        arm=arm,
        acceleration_scale=arm.acceleration_share,
        position_margin=arm.position_margin,
        speed=speed,
        velocity_scale=CommandGuard.SPEED,
        approach_gain=arm.braking_rate(speed * CommandGuard.SPEED, arm.acceleration_share),
        clearance=0.5 * default.clearance,
        obstacle_clearance=0.5 * default.obstacle_clearance,
        table_clearance=0.5 * cell.table_clearance,
        table_height=cell.table_height,
        speed_gain=1.0 / SHORTEST,  # no bound: the guard has its own
    )
    return GuardedCell(options, load_gripper(scenario.gripper), make_static_grid(scenario))
