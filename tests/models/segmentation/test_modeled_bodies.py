"""Points of arm, hand and cell are told from others, against Drake's own geometry."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.segmentation.modeled_bodies import (
    MARGIN,
    Boxes,
    Kind,
    ModeledBodies,
    hand_boxes,
)
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station, station_config
from feasigrasp.systems.station.cell_models import cell_boxes

GRIPPER = ParallelGripper()
FILE = diagram_path("dynamic.scenarios.yaml")
#: A camera far from everything, without noise: margins are `MARGIN`.
X_WC = RigidTransform([0.0, 0.0, -5.0]).GetAsMatrix4()


@pytest.fixture(scope="module")
def station():
    """A cell with a wall and a table."""
    return make_station(
        load_scenario(FILE, "ReachObstacleMocap", "{camera_noise: {}, sensors: {error_factor: 0}}")
    )


def kinds(bodies, points, q, opening, noise=0.0):
    return bodies.kinds(np.asarray(points, dtype=np.float32), X_WC, q, opening, noise)


def distances(station, points, q, opening):
    """Signed distance of points (n, 3) to fingers and palm, and to what is fixed, by Drake."""
    context = station.CreateDefaultContext()
    plant = station.plant
    inside = plant.GetMyMutableContextFromRoot(context)
    plant.SetPositions(inside, plant.GetModelInstanceByName("iiwa"), q)
    plant.SetPositions(inside, plant.GetModelInstanceByName("gripper"), [opening / 2] * 2)
    query = station.GetOutputPort("query_object").Eval(context)
    found = {}
    for name, bodies in (
        ("hand", ("gripper_body", "left_finger", "right_finger")),
        ("cell", ("table_top", "wall")),
    ):
        geometries = {
            g for b in bodies for g in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(b))
        }
        # Tetrahedral meshes know no distance to points; the pads lie in the fingers' boxes.
        found[name] = [
            min(
                (d.distance for d in query.ComputeSignedDistanceToPoint(p) if d.id_G in geometries),
                default=np.inf,
            )
            for p in points
        ]
    return {name: np.array(d) for name, d in found.items()}


@pytest.mark.parametrize("opening", [0.085, 0.03])
def test_points_in_the_hand_are_the_robots(station, opening):
    rng = np.random.default_rng(0)
    q = np.deg2rad([10.0, -48.5, 5.0, -90.6, 0.0, 82.9, 20.0])
    X_WG = forward_kinematics(q, GRIPPER.X_FG)
    points = rng.uniform([-0.08, -0.06, -0.12], [0.08, 0.06, 0.05], (400, 3))
    points = points @ X_WG[:3, :3].T + X_WG[:3, 3]
    found = kinds(ModeledBodies(GRIPPER), points, q, opening)
    hand = distances(station, points, q, opening)["hand"]
    assert (found[hand < 0.0] == Kind.ROBOT).all()
    assert np.count_nonzero(hand < 0.0) > 30
    # In between the pads there is room for an object.
    between = X_WG[:3, 3] + np.outer(np.linspace(-0.3, 0.3, 5) * opening, X_WG[:3, 0])
    assert (kinds(ModeledBodies(GRIPPER), between, q, opening) == Kind.FREE).all()


def test_the_boxes_of_the_cell_are_those_of_its_geometry(station):
    config = station_config(load_scenario(FILE, "ReachObstacleMocap"))
    rng = np.random.default_rng(1)
    points = rng.uniform([0.2, -0.6, -0.1], [0.9, 0.6, 0.6], (600, 3))
    q = np.zeros(7)
    cell = distances(station, points, q, 0.05)["cell"]
    found = kinds(ModeledBodies(GRIPPER, cell_boxes(config)), points, q, 0.05)
    np.testing.assert_array_equal(found[cell < MARGIN - 1e-6] == Kind.CELL, True)
    assert np.count_nonzero(cell < 0.0) > 20
    assert not (found[cell > 1.8 * MARGIN] == Kind.CELL).any()  # corners count sqrt(3) times


def test_points_on_the_links_are_the_robots():
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = IIWA_7.random_positions(rng, 1)[0]
        flange = forward_kinematics(q, np.eye(4))
        points = [[0.0, 0.0, 0.1], [0.0, 0.0, 0.34], flange[:3, 3] - 0.03 * flange[:3, 2]]
        assert (kinds(ModeledBodies(GRIPPER), points, q, 0.05) == Kind.ROBOT).all()


def test_the_margin_grows_with_the_square_of_the_depth():
    box = Boxes(np.eye(4)[None], np.array([[0.1, 0.1, 0.1]]))
    at = X_WC[:3, 3]
    q = np.zeros(7)
    bodies = ModeledBodies(
        GRIPPER, Boxes(RigidTransform([3.0, 0, 0]).GetAsMatrix4()[None], box.half)
    )
    depth = -at[2]
    for noise in (0.0, 1e-3):
        reach = 0.1 + MARGIN + 3.0 * noise * depth**2
        points = [[3.0 + reach - 1e-4, 0.0, 0.0], [3.0 + reach + 1e-4, 0.0, 0.0]]
        assert kinds(bodies, points, q, 0.05, noise).tolist() == [Kind.CELL, Kind.FREE]
    nowhere = [[np.inf, np.inf, np.inf], [np.nan, 0.0, 0.0]]
    assert kinds(bodies, nowhere, q, 0.05).tolist() == [Kind.UNOBSERVED, Kind.UNOBSERVED]


def test_the_fingers_move_with_the_opening():
    for opening in (0.0, 0.05):
        boxes = hand_boxes(GRIPPER, np.eye(4), opening)
        inner = boxes.X_WB[0, 0, 3] - boxes.half[0, 0]
        assert inner == pytest.approx(opening / 2)
        np.testing.assert_allclose(boxes.X_WB[1, :3, 3], boxes.X_WB[0, :3, 3] * [-1, 1, 1])
