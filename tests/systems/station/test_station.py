"""The robot cell does what its ports say: arm, gripper, camera and object."""

import dataclasses

import numpy as np
import open3d as o3d
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CalcContactFrictionFromSurfaceProperties
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import MeshError, ScenarioError
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object, make_motion
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.friction import set_friction
from feasigrasp.systems.station.station import Station, StationConfig

FILE = diagram_path("dynamic.scenarios.yaml")
OPEN = ParallelGripper().max_opening
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])


def scenario(*, cameras=False, mode="safe", model="mug"):
    """A cell with an ideal camera, if any."""
    text = f"{{object: {{model: {model}}}, control: {{mode: {mode}}}, camera_noise: {{}}}}"
    result = load_scenario(FILE, "ReachCircular", text)
    if not cameras:
        result.cameras = {}
    return result


class Cell:
    """A station with a simulator whose inputs can be changed; trials get fresh contexts."""

    def __init__(self, config):
        self.scenario = config
        self.motion = make_motion(config)
        self.station = make_station(config)

    def start(self, q=HOME):
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self.fix("iiwa.desired_state", np.r_[q, np.zeros(7)])
        self.fix("gripper.position", [OPEN])
        self.fix("object.hold", [1.0])
        return self

    def fix(self, name, value):
        self.station.GetInputPort(name).FixValue(self.context, value)

    def advance(self, t):
        self.simulator.AdvanceTo(t)

    def read(self, name):
        value = self.station.GetOutputPort(name).Eval(self.context)
        return value.copy() if isinstance(value, np.ndarray) else value

    def object_pose(self):
        return RigidTransform(self.read("object.pose"))

    def put_object(self, X_WO):
        plant = self.station.plant
        plant.SetFreeBodyPose(
            plant.GetMyMutableContextFromRoot(self.context), self.station.object_body, X_WO
        )


@pytest.fixture(scope="module")
def blind():
    return Cell(scenario())


@pytest.fixture(scope="module")
def seeing():
    return Cell(scenario(cameras=True))


@pytest.fixture(scope="module")
def surface(seeing):
    """Distance of points in O to the object's true surface."""
    obj = load_scenario_object(seeing.scenario)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(obj.vertices.astype(np.float32)),
        o3d.core.Tensor(obj.faces.astype(np.uint32)),
    )
    return lambda x: scene.compute_distance(o3d.core.Tensor(x.astype(np.float32))).numpy()


def test_ports_are_those_of_the_docstring(seeing, ports, documented_ports):
    inputs, outputs = ports(seeing.station)
    documented_inputs, documented_outputs = documented_ports(Station)
    named = [name.replace("<camera>", "wrist_camera") for name in documented_outputs]
    assert list(inputs) == documented_inputs
    assert sorted(outputs) == sorted(named)
    assert inputs == {"iiwa.desired_state": 14, "gripper.position": 1, "object.hold": 1}
    sizes = {name: size for name, size in outputs.items() if size is not None}
    assert sizes == {
        "iiwa.position_measured": 7,
        "iiwa.state_estimated": 14,
        "iiwa.torque_measured": 7,
        "iiwa.torque_external": 7,
        "gripper.state_measured": 2,
    }


def test_it_starts_where_the_scenario_says(blind):
    cell = blind.start()
    np.testing.assert_allclose(
        cell.read("iiwa.state_estimated"), np.r_[np.deg2rad(cell.scenario.q_start), np.zeros(7)]
    )
    np.testing.assert_array_equal(
        cell.read("iiwa.position_measured"), cell.read("iiwa.state_estimated")[:7]
    )
    np.testing.assert_allclose(cell.read("gripper.state_measured"), [OPEN, 0.0])
    np.testing.assert_allclose(cell.object_pose().GetAsMatrix4(), cell.motion.pose(0.0), atol=1e-12)


def test_the_arm_holds_its_place_against_gravity(blind):
    cell = blind.start()
    cell.advance(0.5)
    np.testing.assert_allclose(cell.read("iiwa.position_measured"), HOME, atol=1e-4)


def test_the_arm_tracks_a_moving_desired_state(blind):
    cell = blind.start()
    amplitude, rate = 0.1 * np.array([1, -1, 1, -1, 1, -1, 1]), 1.5
    errors = []
    for k in range(200):
        t = 0.005 * k
        q = HOME + amplitude * (1 - np.cos(rate * t))
        cell.fix("iiwa.desired_state", np.r_[q, amplitude * rate * np.sin(rate * t)])
        errors.append(np.abs(cell.read("iiwa.position_measured") - q).max())
        cell.advance(t + 0.005)
    # A control period at 0.15 rad/s is 0.75 mrad; inertia x acceleration / kp comes on top.
    assert max(errors) < 0.002


def test_a_step_of_the_desired_state_is_reached(blind):
    cell = blind.start()
    q = HOME + 0.05 * np.array([1, -1, 1, 1, -1, 1, -1])
    cell.fix("iiwa.desired_state", np.r_[q, np.zeros(7)])
    cell.advance(1.0)
    np.testing.assert_allclose(cell.read("iiwa.state_estimated"), np.r_[q, np.zeros(7)], atol=2e-3)


@pytest.mark.parametrize("width", [0.01, 0.05, OPEN])
def test_the_gripper_opens_to_the_commanded_width(blind, width):
    cell = blind.start()
    cell.fix("gripper.position", [width])
    cell.advance(0.6)
    measured = cell.read("gripper.state_measured")
    np.testing.assert_allclose(measured, [width, 0.0], atol=5e-4)
    # Either finger is half the width away from the middle, along the closing direction.
    plant = cell.station.plant
    context = plant.GetMyContextFromRoot(cell.context)
    gripper = plant.GetModelInstanceByName("gripper")
    opened = [
        plant.GetJointByName(f"{side}_finger_joint", gripper).get_translation(context)
        for side in ("left", "right")
    ]
    np.testing.assert_allclose(opened, width / 2, atol=5e-4)


def test_the_gripper_closes_until_the_pads_meet(blind):
    cell = blind.start()
    cell.fix("gripper.position", [-0.05])
    cell.advance(0.8)
    assert abs(cell.read("gripper.state_measured")[0]) < 1e-3


def test_the_object_follows_its_motion(blind):
    cell = blind.start()
    for t in np.arange(8, 16) * 0.05:
        cell.advance(round(t, 9))
        X, X_true = cell.object_pose(), RigidTransform(cell.motion.pose(t))
        assert np.linalg.norm(X.translation() - X_true.translation()) < 1e-4
        assert abs((X.rotation().inverse() @ X_true.rotation()).ToAngleAxis().angle()) < 1e-3
        velocity = cell.read("object.velocity").get_coeffs()
        np.testing.assert_allclose(velocity, cell.motion.velocity(t), atol=2e-3)


def test_let_go_the_object_falls(blind):
    cell = blind.start()
    cell.advance(0.3)
    start, speed = cell.object_pose().translation().copy(), cell.motion.velocity(0.3)[3:]
    cell.fix("object.hold", [0.0])
    cell.advance(0.5)
    moved = cell.object_pose().translation() - start
    np.testing.assert_allclose(moved, 0.2 * speed + [0, 0, -9.81 / 2 * 0.2**2], atol=3e-3)


@pytest.mark.parametrize(("mode", "free"), [("safe", False), ("corrected", True), ("paper", True)])
def test_end_stops_and_torque_limits_are_there_only_in_safe_mode(mode, free):
    cell = Cell(scenario(mode=mode)).start()
    beyond = HOME.copy()
    beyond[0] = IIWA_7.position_limits[0] + 0.2
    cell.fix("iiwa.desired_state", np.r_[beyond, np.zeros(7)])
    plant = cell.station.plant
    near = beyond - np.r_[0.3, np.zeros(6)]
    plant.SetPositions(
        plant.GetMyMutableContextFromRoot(cell.context), plant.GetModelInstanceByName("iiwa"), near
    )
    cell.advance(1.0)
    reached = cell.read("iiwa.position_measured")[0]
    efforts = [plant.GetJointActuatorByName(name).effort_limit() for name in IIWA_7.joint_names]
    np.testing.assert_array_equal(efforts, np.full(7, np.inf) if free else IIWA_7.effort_limits)
    if free:
        assert reached == pytest.approx(beyond[0], abs=5e-3)
    else:
        assert reached == pytest.approx(IIWA_7.position_limits[0], abs=0.02)


@pytest.mark.parametrize(
    ("mode", "grips", "expected"),
    [
        ("safe", True, {"itself", "object", "cell"}),
        ("safe", False, {"itself", "object", "cell"}),
        ("paper", True, {"object"}),
        ("paper", False, set()),
    ],
)
def test_what_the_robot_can_touch(mode, grips, expected):
    config = scenario(mode=mode)
    config.grasp.close = grips
    cell = Cell(config).start()
    plant, robot = cell.station.plant, set(cell.station.robot_instances())
    inspector = cell.read("query_object").inspector()

    def touched(pair):
        bodies = [plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)) for geometry in pair]
        others = [body for body in bodies if body.model_instance() not in robot]
        if len(others) == 2:
            return "nothing of the robot"
        if not others:
            return "itself"
        return "object" if others[0].index() == cell.station.object_body.index() else "cell"

    candidates = {touched(pair) for pair in inspector.GetCollisionCandidates()}
    assert candidates - {"nothing of the robot"} == expected


@pytest.mark.parametrize("friction", [0.6, 0.25])
def test_gripper_and_object_touch_with_the_scenarios_friction(friction):
    """Of every pair of surfaces that can touch, in the running cell, combined as Drake does."""
    config = scenario()
    config.object.friction = friction
    cell = Cell(config).start()
    plant, station = cell.station.plant, cell.station
    inspector = cell.read("query_object").inspector()
    gripper = plant.GetModelInstanceByName("gripper")
    wanted = {gripper, station.object_instance}
    found = []
    for pair in inspector.GetCollisionCandidates():
        bodies = [plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)) for geometry in pair]
        if {body.model_instance() for body in bodies} == wanted:
            surfaces = [inspector.GetProximityProperties(geometry) for geometry in pair]
            given = [s.GetProperty("material", "coulomb_friction") for s in surfaces]
            found.append(CalcContactFrictionFromSurfaceProperties(*given))
    assert len(found) == 5  # palm, two pads, and the back of either finger
    for pair in found:
        assert pair.static_friction() == pytest.approx(friction, abs=1e-12)
        assert pair.dynamic_friction() == pytest.approx(friction, abs=1e-12)
    assert station.contact_friction() == pytest.approx(friction, abs=1e-12)


def test_friction_that_differs_from_the_scenarios_is_seen():
    """Pads of the model file's 0.8 on an object of 0.6 make 0.686, not 0.6."""
    config = scenario()
    config.object.friction = 0.6
    station = make_station(config)
    gripper = station.plant.GetModelInstanceByName("gripper")
    set_friction(station.plant, station.scene_graph, gripper, 0.8)
    assert station.contact_friction() == pytest.approx(2 * 0.6 * 0.8 / (0.6 + 0.8))


def test_the_point_cloud_lies_on_the_true_object(seeing, surface):
    cell = seeing.start()
    cell.advance(0.01)
    labels = cell.read("wrist_camera.label_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    on_object = labels == int(cell.station.object_body.index())
    assert on_object.sum() > 500
    points = xyz[:, on_object]
    assert np.isfinite(points).all()
    distance = surface((cell.object_pose().inverse() @ points).T)
    assert distance.max() < 1e-5  # half a pixel would be 5e-4


def test_no_other_label_lies_on_the_object(seeing, surface):
    """A label is the index of a body: all that touches the object's surface bears its own."""
    cell = seeing.start()
    cell.advance(0.01)
    labels = cell.read("wrist_camera.label_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    others = np.isfinite(xyz).all(axis=0) & (labels != int(cell.station.object_body.index()))
    assert others.sum() > 500
    assert surface((cell.object_pose().inverse() @ xyz[:, others]).T).min() > 2e-3
    bodies = cell.station.plant.num_bodies()
    assert np.all(labels[others] < bodies)


def test_an_object_nearer_than_the_depth_range_has_labels_but_no_points(seeing):
    cell = seeing.start()
    X_WC = cell.read("wrist_camera.pose")
    z_near = cell.scenario.cameras["wrist_camera"].z_near
    cell.put_object(X_WC @ RigidTransform([0.0, 0.0, z_near - 0.05]))
    labels = cell.read("wrist_camera.label_image").data.ravel()
    depth = cell.read("wrist_camera.depth_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    too_near = (labels == int(cell.station.object_body.index())) & (depth == 0.0)
    assert too_near.sum() > 500
    assert not np.isfinite(xyz[:, too_near]).any(axis=0).any()


def test_the_camera_moves_with_the_hand(seeing):
    """Its pose against Drake's own kinematics, and the object in the middle of its picture."""
    cell = seeing.start()
    plant = cell.station.plant
    frame = plant.GetFrameByName("camera_optical")
    for q in (HOME, HOME + 0.1):
        context = plant.GetMyMutableContextFromRoot(cell.context)
        plant.SetPositions(context, plant.GetModelInstanceByName("iiwa"), q)
        X_WC = cell.read("wrist_camera.pose").GetAsMatrix4()
        expected = frame.CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(X_WC, expected, atol=1e-12)
    assert X_WC[2, 3] > 0.3


def test_a_fresh_context_is_a_fresh_trial(blind):
    runs = []
    for _ in range(2):
        cell = blind.start()
        cell.advance(0.1)
        runs.append(cell.object_pose().GetAsMatrix4())
    np.testing.assert_array_equal(*runs)


def test_a_cell_without_an_arm_is_refused_by_name():
    bare = dataclasses.replace(_config(scenario()), directives=[])
    with pytest.raises(RuntimeError, match="iiwa"):
        Station(bare, load_scenario_object(scenario()), make_motion(scenario()))


def test_an_unknown_object_is_refused_by_name():
    unknown = scenario()
    unknown.object.model = "no_such_thing"
    with pytest.raises(MeshError, match="no_such_thing"):
        make_station(unknown)


def _config(of):
    return StationConfig(plant=of.plant_config, directives=of.directives, q_start=HOME)


def test_a_cell_that_cannot_be_loaded_is_a_clear_error():
    text = "{directives: [{add_directives: {file: package://nowhere/cell.dmd.yaml}}]}"
    broken = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    with pytest.raises(ScenarioError, match=r"(?s)cannot be loaded.*cell\.dmd\.yaml"):
        make_station(broken)


def test_every_shape_of_the_robot_meets_surfaces_and_not_hulls(blind):
    station = blind.station
    inspector = station.scene_graph.model_inspector()
    bodies = [b for i in station.robot_instances() for b in station.plant.GetBodyIndices(i)]
    shapes = [
        shape
        for body in bodies
        for shape in station.plant.GetCollisionGeometriesForBody(station.plant.get_body(body))
    ]
    assert len(shapes) > 20
    for shape in shapes:
        assert inspector.maybe_get_hydroelastic_mesh(shape) is not None, inspector.GetName(shape)


def least_distance(points, mesh):
    """Of points to a closed surface, negative inside."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.asarray(mesh.vertices, dtype=np.float32)),
        o3d.core.Tensor(np.asarray(mesh.faces, dtype=np.uint32)),
    )
    return scene.compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy().min()


def test_a_finger_in_a_bowl_touches_nothing():
    """One finger inside a bowl and one outside of it, a few mm from the wall: no contact."""
    cell = Cell(scenario(model="bowl")).start()
    obj, gripper = load_scenario_object(cell.scenario), ParallelGripper()
    top = obj.vertices[:, 2].max()
    rim = np.linalg.norm(obj.vertices[obj.vertices[:, 2] > top - 0.005][:, :2], axis=1).mean()
    X_OG = RigidTransform([[1.0, 0, 0, rim], [0, -1.0, 0, 0], [0, 0, -1.0, top - 0.01]])
    hand = X_OG.multiply(gripper.surface_points(OPEN).T).T
    assert least_distance(hand, obj.mesh) > 0.005 and least_distance(hand, obj.mesh.convex_hull) < 0
    X_WG = RigidTransform(forward_kinematics(HOME, gripper.X_FG))
    cell.put_object(X_WG.multiply(X_OG.inverse()))
    results = cell.read("contact_results")
    assert results.num_hydroelastic_contacts() + results.num_point_pair_contacts() == 0
