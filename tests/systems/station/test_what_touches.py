"""What in the cell can touch what: which shapes, and with which friction."""

import numpy as np
import open3d as o3d
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CalcContactFrictionFromSurfaceProperties

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.object_model import set_friction
from tests.cell import HOME, OPEN, Cell, scenario


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
