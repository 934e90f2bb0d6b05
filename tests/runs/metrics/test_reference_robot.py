"""The robot's twin against its meshes, closed forms, and the capsules that it judges."""

import ast
import inspect

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path, model_path
from feasigrasp.runs.metrics import reference_robot as module
from feasigrasp.runs.metrics.reference_robot import ReferenceRobot
from feasigrasp.scenario.files import load_scenario

READY = np.deg2rad([0, 30, 0, -60, 0, 90, 0])
G = 9.81


@pytest.fixture(scope="module")
def reference():
    return ReferenceRobot(
        load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap").directives
    )


def surfaces(reference, q, n=4000):
    """Points on the visible bodies in the world, by name."""
    meshes = {f"iiwa_link_{k}": f"link_{k}" for k in range(8)}
    meshes |= {name: name for name in ("gripper_body", "left_finger", "right_finger")}
    meshes["camera_body"] = "camera"
    reference.plant.SetPositions(reference._context, reference._arm, q)
    found = {}
    for body, name in meshes.items():
        mesh = trimesh.load(model_path("iiwa", "meshes", f"{name}.gltf"), process=False).to_mesh()
        points, _ = trimesh.sample.sample_surface(mesh, n, seed=0)
        points = points[:, [0, 2, 1]] * [1, -1, 1]
        X_WB = (
            reference.plant.GetBodyByName(body).EvalPoseInWorld(reference._context).GetAsMatrix4()
        )
        found[body] = points @ X_WB[:3, :3].T + X_WB[:3, 3]
    return found


def test_bodies_and_pairs(reference):
    assert reference.names[:8] == list(IIWA_7.link_names)
    assert len(reference.names) == 12 and len(reference.pairs) == 45
    named = {(reference.names[a], reference.names[b]) for a, b in reference.pairs}
    assert ("iiwa_link_0", "iiwa_link_2") in named
    assert ("iiwa_link_6", "gripper_body") not in named  # the hand moves with link 7


def test_distances_are_those_of_the_visible_surfaces(reference):
    """Sampled surfaces are never nearer than the hulls, and far away not much farther."""
    rng = np.random.default_rng(4)
    for q in (READY, *IIWA_7.random_positions(rng, 3)):
        (distances,) = reference.self_distances(q[None])
        points = surfaces(reference, q)
        for (a, b), distance in zip(reference.pairs, distances, strict=True):
            sampled = cKDTree(points[reference.names[a]]).query(points[reference.names[b]])[0].min()
            assert distance <= sampled + 1e-4
            if distance > 0.2:  # far away, hull and body differ least
                assert distance > sampled - 0.05


def test_the_forearm_leaves_room_for_the_wrist(reference):
    """Its hull as a whole would be in collision with the flange from 90 degrees of joint 6 on."""
    k = [(reference.names[a], reference.names[b]) for a, b in reference.pairs].index(
        ("iiwa_link_5", "iiwa_link_7")
    )
    Q = np.zeros((25, 7))
    Q[:, 5] = np.linspace(-1, 1, 25) * IIWA_7.upper[5]
    distances = reference.self_distances(Q)[:, k]
    assert (distances[1:-1] > 0.0).all() and distances[12] > 0.03
    Q[:, 5] *= 1.1  # beyond the limit it does collide
    assert reference.self_distances(Q)[[0, -1], k].max() < 0.0


def test_ready_is_free_and_folded_is_not(reference):
    assert (reference.self_distances(READY[None]) > 0.0).all()
    Q = np.zeros((1, 7))
    Q[0, 3] = -3.1
    assert reference.self_distances(Q).min() < -0.02


def test_points_inside_another_body_are_found(reference):
    """Where sampled points of one visible body lie inside another one, the twin says so."""
    Q = IIWA_7.random_positions(np.random.default_rng(6), 4000)
    hit = (reference.self_distances(Q, 0.0) < -0.02).any(axis=1)
    checked = 0
    for q in Q[hit][:4]:
        points = surfaces(reference, q, n=20000)
        (distances,) = reference.self_distances(q[None], 0.0)
        a, b = reference.pairs[np.argmin(distances)]
        near = cKDTree(points[reference.names[a]]).query(points[reference.names[b]])[0].min()
        assert near < 0.012  # surfaces that cross come as near as the samples are dense
        checked += 1
    assert checked == 4


def test_what_does_not_matter_is_left_out(reference):
    Q = IIWA_7.random_positions(np.random.default_rng(7), 50)
    everything, near = reference.self_distances(Q), reference.self_distances(Q, 0.1)
    np.testing.assert_allclose(near[near < 0.1], everything[near < 0.1], atol=1e-6)
    assert np.isinf(near[everything > 0.101]).all() and np.isfinite(near).any()


def test_gravity_torques_are_levers_times_weights(reference):
    """By finite differences of the potential energy of arm, hand and camera."""
    plant, context = reference.plant, reference._context
    for q in IIWA_7.random_positions(np.random.default_rng(8), 3):

        def energy(q):
            plant.SetPositions(context, reference._arm, q)
            return -plant.CalcPotentialEnergy(context)

        step = 1e-5
        slope = [(energy(q - step * e) - energy(q + step * e)) / (2 * step) for e in np.eye(7)]
        np.testing.assert_allclose(reference.gravity_torques(q[None])[0], slope, atol=1e-4)
    assert abs(reference.gravity_torques(np.zeros((1, 7)))).max() < 2.0  # upright, nothing leans
    # Stretched out to the front, the shoulder bears what the links weigh, at most at full reach.
    flat = np.zeros((1, 7))
    flat[0, 1] = np.pi / 2
    reach = forward_kinematics(flat[0], np.eye(4))[0, 3]
    assert 0.2 * reach * 19.0 * G < abs(reference.gravity_torques(flat)[0, 1]) < reach * 19.0 * G


def test_it_shares_no_code_with_the_controllers():
    imported = [
        node.module
        for node in ast.walk(ast.parse(inspect.getsource(module)))
        if isinstance(node, ast.ImportFrom)
    ]
    ours = [name for name in imported if name and name.startswith("feasigrasp.")]
    assert ours and not any("capsule" in name or "collision" in name for name in ours)
    assert not any("systems" in name or "control" in name for name in ours)
