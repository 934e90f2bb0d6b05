"""The capsules against the visible robot; their checker against Drake's geometry engine."""

from itertools import combinations

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Capsule as CapsuleShape
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.robot.capsule_kernels import is_clear_kernel
from feasigrasp.models.robot.capsules import (
    HAND_NAMES,
    capsule_model,
    hand_capsules,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path, model_path
from feasigrasp.runs.metrics.reference_robot import ReferenceRobot
from feasigrasp.scenario.files import load_scenario
from feasigrasp_lab import arm as sc
from tests.truths import min_distance, signed_distances, table_distances

BODY_NAMES = (*IIWA_7.link_names, *HAND_NAMES)
BODY_LINK = np.minimum(np.arange(len(BODY_NAMES)), IIWA_7.joints)
CAPSULES = IIWA_7.capsules + hand_capsules()
BODY = np.array([capsule.body for capsule in CAPSULES])
#: Every pair that is not neighbours.
ALL_PAIRS = [
    (a, b) for a, b in combinations(range(len(BODY_NAMES)), 2) if BODY_LINK[b] - BODY_LINK[a] >= 2
]


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


def mixed_configurations(n, seed):
    """Uniform samples hardly ever collide, so the other half is folded back towards the base."""
    Q = random_configurations(n, seed)
    folded = Q[n // 2 :]
    folded[:, [2, 4]] *= 0.2
    folded[:, [1, 3, 5]] = np.sign(folded[:, :1]) * np.abs(folded[:, [1, 3, 5]]) * (1, -1, 1)
    folded[:, [1, 3]] = (folded[:, [1, 3]] + np.sign(folded[:, [1, 3]]) * IIWA_7.upper[1]) / 2
    return Q


class DrakeArm:
    """Our URDF in a plant, with the hand's capsules on massless geometry of link 7."""

    def __init__(self):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
        parser = Parser(self.plant)
        parser.package_map().Add("feasigrasp", str(model_path()))
        parser.AddModels(str(model_path("iiwa", "iiwa7.urdf")))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("iiwa_link_0"))
        link_7 = self.plant.GetBodyByName("iiwa_link_7")
        for k in range(len(IIWA_7.capsules), len(CAPSULES)):
            a, b = np.array(CAPSULES[k].a), np.array(CAPSULES[k].b)
            rotation = RotationMatrix.MakeFromOneVector(b - a, 2)
            self.plant.RegisterCollisionGeometry(
                link_7,
                RigidTransform(rotation, (a + b) / 2),
                CapsuleShape(CAPSULES[k].radius, np.linalg.norm(b - a)),
                f"hand_{k}",
                CoulombFriction(),
            )
        self.plant.Finalize()
        # Names are iiwa7::capsule_<k-th of its link, in the order of the arm's>, hand_<index>.
        inspector = self.scene_graph.model_inspector()
        self.capsule_of = {}
        for geometry in inspector.GetAllGeometryIds(Role.kProximity):
            kind, number = inspector.GetName(geometry).split("::")[-1].split("_")
            frame = inspector.GetName(inspector.GetFrameId(geometry)).split("::")[-1]
            body = BODY_NAMES.index(frame) if frame in BODY_NAMES else 0  # the base is anchored
            own = np.flatnonzero(body == BODY)
            self.capsule_of[geometry] = int(number if kind == "hand" else own[int(number)])
        assert sorted(self.capsule_of.values()) == list(range(len(CAPSULES)))
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self.plant_context = self.plant.GetMyContextFromRoot(self.context)

    def query(self, q):
        self.plant.SetPositions(self.plant_context, q)
        context = self.scene_graph.GetMyContextFromRoot(self.context)
        return self.scene_graph.get_query_output_port().Eval(context)

    def distance(self, q, pair):
        ids = {capsule: geometry for geometry, capsule in self.capsule_of.items()}
        query = self.query(q)
        return query.ComputeSignedDistancePairClosestPoints(ids[pair[0]], ids[pair[1]]).distance


@pytest.fixture(scope="module")
def drake_arm():
    return DrakeArm()


def test_collision_filter_leaves_exactly_the_pairs_of_the_checker(drake_arm):
    inspector = drake_arm.scene_graph.model_inspector()
    arm_only = {g: c for g, c in drake_arm.capsule_of.items() if BODY[c] < 8}
    enabled = set()
    for g, h in inspector.GetCollisionCandidates():
        if g in arm_only and h in arm_only:
            enabled.add(tuple(sorted((arm_only[g], arm_only[h]))))
    expected = {tuple(p) for p in capsule_model(with_hand=False).pairs.tolist()}
    assert enabled == expected


def test_distances_agree_with_scene_graph(drake_arm):
    model = capsule_model()
    checked = 0
    for q in random_configurations(40, seed=1):
        ours = signed_distances(q)
        for pair, distance in zip(model.pairs.tolist(), ours, strict=True):
            theirs = drake_arm.distance(q, pair)
            # Drake measures capsules with an iterative solver.
            assert distance == pytest.approx(theirs, abs=2e-4 if theirs > 0 else 1e-3)
            checked += 1
    assert checked == 40 * len(model.pairs)


def test_verdicts_agree_with_scene_graph(drake_arm):
    model = capsule_model()
    pairs = {frozenset(p) for p in model.pairs.tolist()}
    Q = mixed_configurations(5000, seed=2)
    ours = sc.in_collision(Q)
    theirs = np.empty(len(Q), dtype=bool)
    for n, q in enumerate(Q):
        hits = drake_arm.query(q).ComputePointPairPenetration()
        touching = {
            frozenset((drake_arm.capsule_of[h.id_A], drake_arm.capsule_of[h.id_B])) for h in hits
        }
        theirs[n] = bool(touching & pairs)
    assert 100 < theirs.sum() < 4900
    np.testing.assert_array_equal(ours, theirs)


def test_margin_and_minimum_are_consistent():
    Q = random_configurations(500, seed=3)
    smallest = np.array([min_distance(q) for q in Q])
    np.testing.assert_array_equal(sc.in_collision(Q), smallest < 0)
    np.testing.assert_array_equal(sc.in_collision(Q, margin=0.05), smallest < 0.05)


MODELS = {
    "default": capsule_model(),
    "without hand": capsule_model(with_hand=False),
    "all pairs": capsule_model(body_pairs=ALL_PAIRS),
    "two pairs": capsule_model().with_pairs(capsule_model().pairs[[15, 3]]),
}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("margin", [-0.02, 0.0, 0.005])
def test_quick_verdicts_are_the_signs_of_the_distances(model, margin):
    Q = mixed_configurations(3000, seed=7)
    expected = signed_distances(Q, model).min(axis=1) < margin
    assert 0 < expected.sum() < len(Q)
    np.testing.assert_array_equal(sc.in_collision(Q, model, margin), expected)


@pytest.mark.parametrize("n", [0, 1, 197])
def test_any_number_of_configurations(n):
    Q = mixed_configurations(2 * n, seed=8)[n:]
    expected = [min_distance(q) < 0.0 for q in Q]
    np.testing.assert_array_equal(sc.in_collision(Q), expected)


@pytest.mark.parametrize("height", [-0.3, 0.1, 0.2])
def test_clear_of_itself_and_of_a_table(height):
    model, clearance = capsule_model(), 0.03
    without_hand = model._replace(movers=model.movers[model.link[model.movers] < 7])
    seen = set()
    for q in mixed_configurations(1500, seed=9):
        apart = min_distance(q) >= clearance
        for chosen in (model, without_hand):
            above = table_distances(q, height, chosen).min() >= clearance
            assert is_clear_kernel(q, chosen, clearance, height + clearance) == (apart and above)
            seen.add((apart, above))
    assert {(True, True), (True, False)} <= seen


def test_balls_hold_the_capsules_of_their_links():
    model = capsule_model()
    for link, ends, radius in zip(model.link, model.ends, model.radius, strict=True):
        reach = np.linalg.norm(ends - model.balls[link, :3], axis=1) + radius
        assert (reach <= model.balls[link, 3] + 1e-12).all()


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_groups_are_the_pairs_in_order(model):
    covered = [k for _, _, first, end in model.groups for k in range(first, end)]
    assert covered == list(range(len(model.pairs)))
    for low, high, first, end in model.groups:
        assert (model.link[model.pairs[first:end]] == (low, high)).all()


def test_batches_of_distances():
    Q = random_configurations(6, seed=10)
    distance = signed_distances(Q.reshape(2, 3, 7))
    for k, q in enumerate(Q):
        np.testing.assert_array_equal(distance[k // 3, k % 3], signed_distances(q))


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_an_unknown_configuration_is_not_free(joint, bad, model):
    Q = np.zeros((3, 7))
    Q[1, joint] = bad
    np.testing.assert_array_equal(sc.in_collision(Q, model), [False, True, False])


@pytest.fixture(scope="module")
def reference():
    """The visible robot: its distances owe nothing to the capsules."""
    return ReferenceRobot(
        load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap").directives
    )


def test_left_out_pairs_stay_apart(reference):
    """Random search, then descent by random steps, over the joint limits, for every other pair."""
    seen = {"palm": "gripper_body", "camera": "camera_body"}
    names = [seen.get(name, name) for name in BODY_NAMES]
    checked = {(names[a], names[b]) for a, b in IIWA_7.pairs}
    pairs = [(reference.names[a], reference.names[b]) for a, b in reference.pairs]
    assert checked < set(pairs)
    rng, bound = np.random.default_rng(6), IIWA_7.upper
    Q = random_configurations(3000, seed=5)
    Q = np.where(rng.random(Q.shape) < 0.3, np.sign(Q) * bound, Q)
    D = reference.self_distances(Q, 0.15)
    searched = 0
    for k, pair in enumerate(pairs):
        if pair in checked:
            continue
        n = np.argmin(D[:, k])
        best, q = D[n, k], Q[n]
        if not np.isfinite(best):
            continue
        for size in np.geomspace(0.3, 0.003, 60):
            trial = np.clip(q + rng.normal(0.0, size, 7), -bound, bound)
            distance = reference.self_distances(trial[None], 0.15)[0, k]
            best, q = (distance, trial) if distance < best else (best, q)
        # The flange comes near the forearm when the wrist is bent to its limit.
        bar = 0.0 if pair == ("iiwa_link_5", "iiwa_link_7") else 0.02
        assert best > bar, f"{pair} come within {best:.3f} m"
        searched += 1
    assert searched > 5


def test_what_capsules_call_free_is_free(reference):
    """At the controllers' clearance of 1 cm, by the visible bodies: no collision is missed."""
    Q = mixed_configurations(3000, seed=11)
    free = ~sc.in_collision(Q, margin=0.01)
    collides = np.array([(reference.self_distances(q[None], 0.0) < 0.0).any() for q in Q])
    assert 100 < collides.sum() < 1500
    assert not (free & collides).any()
    # And not much of what is free is given up: before the capsules held the links, 7 %.
    assert (~free & ~collides)[1500:].mean() < 0.12


@pytest.mark.parametrize("gripper", [ParallelGripper(), WSG_50], ids=["default", "WSG 50"])
def test_hand_capsules_hold_the_hand(gripper):
    X_7G = gripper.X_FG.copy()
    X_7G[2, 3] += 0.045
    x = (gripper.max_opening + gripper.finger_thickness) / 2
    length = gripper.tip - gripper.heel
    finger = (gripper.finger_thickness, gripper.finger_width, length)
    along = gripper.tip - length / 2
    boxes = {
        "palm": ((0, 0, gripper.heel - gripper.palm_size[2] / 2), gripper.palm_size),
        "left_finger": ((x, 0, along), finger),
        "right_finger": ((-x, 0, along), finger),
        "camera": (gripper.camera_center, gripper.camera_box),
    }
    for name, (center, size) in boxes.items():
        corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * size + center
        corners = corners @ X_7G[:3, :3].T + X_7G[:3, 3]
        own = [c for c in hand_capsules(gripper) if BODY_NAMES[c.body] == name]
        assert np.min([outside(corners, c) for c in own], axis=0).max() < 1e-9, name


def outside(points, capsule):
    """How far points (n, 3) stand out of a capsule [m]."""
    a, b = np.array(capsule.a), np.array(capsule.b)
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1) - capsule.radius


def test_capsules_hold_every_visible_vertex(reference):
    """None stands out of the capsules of its link: no clearance has to take up a difference."""
    checked = 0
    for link in range(8):
        names = [name for name, k in zip(BODY_NAMES, BODY_LINK, strict=True) if k == link]
        capsules = [c for c in CAPSULES if BODY_NAMES[c.body] in names]
        seen = {"palm": "gripper_body", "camera": "camera_body"}
        points = np.concatenate([visible_points(reference, seen.get(n, n), link) for n in names])
        assert np.min([outside(points, c) for c in capsules], axis=0).max() < 0.0, link
        checked += len(points)
    assert checked > 20000


def visible_points(reference, name, link):
    """Vertices of a body's mesh in the frame of the link that it moves with, shape (n, 3)."""
    files = {f"iiwa_link_{k}": f"link_{k}" for k in range(8)} | {"camera_body": "camera"}
    path = model_path("iiwa", "meshes", f"{files.get(name, name)}.gltf")
    points = trimesh.load(path, process=False).to_mesh().vertices[:, [0, 2, 1]] * [1, -1, 1]
    frame = reference.plant.GetFrameByName(f"iiwa_link_{link}")
    X = reference.plant.GetFrameByName(name).CalcPose(reference._context, frame).GetAsMatrix4()
    return points @ X[:3, :3].T + X[:3, 3]


def test_table_clearance_of_the_upright_arm():
    """At q = 0 with the table at 0.2 m: the lowest mover is link 2's drum, 0.34 - 0.075 m high."""
    clearance = table_distances(np.zeros(7), 0.2)
    assert clearance.min() == pytest.approx(0.34 - 0.075 - 0.2)
    assert clearance.shape == (2 * len(capsule_model().movers),)
    turned = table_distances(np.eye(7)[0], 0.2)  # turning the base moves nothing up
    np.testing.assert_array_equal(turned, clearance)


def test_bad_input():
    with pytest.raises(ValueError, match=r"shape \(..., 7\)"):
        signed_distances(np.zeros(6))
    with pytest.raises(ValueError, match=r"shape \(7,\)"):
        min_distance(np.zeros((2, 7)))
    with pytest.raises(ValueError, match=r"shape \(n, 7\)"):
        sc.in_collision(np.zeros(7))
    with pytest.raises(ValueError, match="shape"):
        signed_distances(np.zeros((2, 6)))
