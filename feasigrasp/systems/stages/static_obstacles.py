"""Makes the distance grid of the bodies that stand in a scenario's cell."""

from __future__ import annotations

import numpy as np

from feasigrasp.errors import ScenarioError
from feasigrasp.models.control.planning.static_grid import static_grid
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.scenario.sampling import make_static_obstacles
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import station_config
from feasigrasp.systems.station.cell_boxes import cell_boxes
from feasigrasp.systems.station.directives import modeled_bodies


def make_static_grid(scenario: Scenario) -> ObstacleGrid | None:
    """Distances to the bodies of the scenario's cell but robot and table; None if it has none.

    Raises:
        ScenarioError: The arm begins in one of them.
        MeshError: A mesh cannot be read, or is flat.
    """
    obstacles = make_static_obstacles(scenario)
    if names := modeled_bodies(scenario):
        X_WB, half, _ = cell_boxes(station_config(scenario), names)
        name = ", ".join(names)
        obstacles += [StaticObstacle.box(name, 2.0 * h, X) for X, h in zip(X_WB, half, strict=True)]
    if not obstacles:
        return None
    balls = arm_balls(capsule_model(load_gripper(scenario.gripper), load_arm(scenario.arm)))
    center = balls.placed(scenario.start)
    for obstacle in obstacles:
        room = float(np.min(obstacle.distance(center) - balls.radius))
        if room < 0.0:
            raise ScenarioError(
                f"the obstacle {obstacle.name} of cell is {-100.0 * room:.1f} cm in the arm at "
                "q_start; move one of them"
            )
    return static_grid(obstacles)
