"""What is only seen: its labels, where the camera sees it, that it lets go and touches nothing."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from feasigrasp.models.objects.distractor_bodies import CarrierKind, make_carrier
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import (
    load_scenario_object,
    make_distractor_bodies,
    make_motion,
)
from feasigrasp.systems.station.object_model import DistractorBodies
from tests.cell import Cell

FILE = diagram_path("dynamic.scenarios.yaml")
IDEAL = "{camera_noise: {}, sensors: {error_factor: 0}, object: {model: mug}}"


@pytest.fixture(scope="module")
def carried():
    text = "{carrier: {kind: hand}, distractor: {model: duck, offset: [-0.1, 0.15, -0.1]}}"
    return Cell(load_scenario(FILE, "ReachLinearMocap", IDEAL, text))


def shown(cell):
    """Points in W (n, 3) and labels (n,) of what the camera sees."""
    points = cell.read("wrist_camera.point_cloud").xyzs().T
    return points, cell.read("wrist_camera.label_image").data.ravel()


def labels(cell):
    """Those of the object, the carrier and the other object."""
    bodies = cell.station.plant.num_bodies()
    return cell.station.object_label, bodies, bodies + 1


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    given, outputs = ports(DistractorBodies([], []))
    assert (list(given), list(outputs)) == documented_ports(DistractorBodies)
    assert given == {"let_go": 1, "time": 1}


def test_each_has_a_label_of_its_own_and_is_seen(carried):
    cell = carried.start()
    _, label = shown(cell)
    for one in labels(cell):
        assert np.count_nonzero(label == one) > 300
    plant_bodies = range(cell.station.plant.num_bodies())
    assert cell.station.object_label in plant_bodies
    assert not {*labels(cell)[1:]} & {*plant_bodies}


@pytest.mark.parametrize("t", [0.0, 0.4])
def test_a_carrier_is_seen_where_the_object_takes_it(carried, t):
    cell = carried.start()
    cell.advance(t)
    obj, motion = load_scenario_object(cell.scenario), make_motion(cell.scenario)
    hand = make_carrier(CarrierKind.HAND, obj, motion, None)
    points, label = shown(cell)
    seen_W = points[label == labels(cell)[1]]
    X_CW = np.linalg.inv(hand.pose(t, 0.0))
    seen_C = seen_W[np.isfinite(seen_W).all(axis=1)] @ X_CW[:3, :3].T + X_CW[:3, 3]
    surface, _ = trimesh.sample.sample_surface(hand.mesh, 200_000, seed=0)  # 1 mm apart
    distance, _ = cKDTree(surface).query(seen_C)
    assert len(seen_C) > 300
    assert np.percentile(distance, 98) < 0.002


def test_another_object_is_seen_beside_the_path(carried):
    cell = carried.start()
    cell.advance(0.3)
    points, label = shown(cell)
    seen = points[label == labels(cell)[2]]
    middle = seen[np.isfinite(seen).all(axis=1)].mean(axis=0)
    expected = np.array(cell.scenario.motion.center) + cell.scenario.distractor.offset
    assert np.linalg.norm(middle - expected) < 0.035  # its radius; its near side is seen


def test_another_object_stands_where_the_path_is_drawn():
    text = "{motion: {spread: [0.3, 0.3, 0.1]}, distractor: {model: duck}, random_seed: 3}"
    scenario = load_scenario(FILE, "ReachLinearMocap", IDEAL, text)
    motion = make_motion(scenario)
    (other,) = make_distractor_bodies(scenario, load_scenario_object(scenario), motion)
    expected = motion.center + scenario.distractor.offset
    np.testing.assert_allclose(other.pose(0.0, np.inf)[:3, 3], expected)


def test_it_draws_back_when_the_object_is_let_go(carried):
    cell = carried.start()
    cell.advance(0.1)
    held = hand_middle(cell) - cell.motion.pose(0.1)[:3, 3]
    cell.fix("object.hold", [0.0])
    later = 0.5 + cell.scenario.carrier.release_delay
    cell.advance(later)
    drawn = hand_middle(cell) - cell.motion.pose(later)[:3, 3]
    # 0.4 s at 0.3 m/s; that the view of it changes shifts the middle of what is seen.
    assert np.linalg.norm(drawn - held) == pytest.approx(0.12, abs=0.05)
    assert drawn[0] > held[0] + 0.06


def hand_middle(cell):
    points, label = shown(cell)
    seen = points[label == labels(cell)[1]]
    return seen[np.isfinite(seen).all(axis=1)].mean(axis=0)


def test_the_object_moves_as_it_does_alone(carried):
    alone = Cell(load_scenario(FILE, "ReachLinearMocap", IDEAL))
    poses = []
    for cell in (carried, alone):
        cell.start()
        cell.advance(0.2)
        poses.append(cell.object_pose().GetAsMatrix4())
    np.testing.assert_array_equal(*poses)
    assert not alone.station.HasSubsystemNamed("distractor_bodies")
    assert not alone.station.HasSubsystemNamed("camera_distractor_bodies")
