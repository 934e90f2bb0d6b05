"""Table and obstacles of a scenario's cell: wherever the cell is known, they are."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.errors import ScenarioError
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.models.segmentation.modeled_bodies import Kind
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import (
    make_controller,
    make_foreground_segmentation,
    make_reachability,
    make_static_grid,
    make_station,
    station_config,
)
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp.systems.station.cell_models import cell_boxes
from feasigrasp.systems.station.directives import cell_directives
from tests.pipeline import FILE
from tests.truths import table_distances

SHELF = "{size: [0.3, 0.4, 0.02], position: [0.55, 0.4, 0.35], rpy_deg: [0, 0, 90]}"
CELL_TEXT = f"{{cell: {{table_height: -0.1, boxes: {{shelf: {SHELF}}}}}}}"


def own(text=CELL_TEXT):
    return load_scenario(FILE, "ReachLinearMocap", text)


def frame(station, name):
    context = station.plant.CreateDefaultContext()
    return station.plant.GetFrameByName(name).CalcPoseInWorld(context).GetAsMatrix4()


def test_table_and_shelf_stand_in_the_simulated_cell():
    station = make_station(own())
    np.testing.assert_allclose(frame(station, "table_top")[:3, 3], [0.0, 0.0, -0.1])
    X_WB = frame(station, "shelf")
    np.testing.assert_allclose(X_WB[:3, 3], [0.55, 0.4, 0.35])
    np.testing.assert_allclose(X_WB[:3, :3] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    inspector, shelf = station.scene_graph.model_inspector(), station.plant.GetBodyByName("shelf")
    assert len(station.plant.GetCollisionGeometriesForBody(shelf)) == 1
    assert len(station.plant.GetVisualGeometriesForBody(shelf)) == 1
    (geometry,) = station.plant.GetCollisionGeometriesForBody(shelf)
    assert inspector.GetProximityProperties(geometry).HasProperty("material", "coulomb_friction")


def test_the_camera_sees_the_shelf_and_its_pixels_belong_to_the_cell():
    """The wrist camera looks at a wall before it: depth, label, and what they are taken for."""
    text = "{cell: {boxes: {wall: {size: [0.02, 0.8, 0.8], position: [0.95, 0, 0.5]}}}}"
    setting = load_scenario(
        FILE, "ReachLinearMocap", text, "{camera_noise: {}, sensors: {error_factor: 0}}"
    )
    station = make_station(setting)
    context = station.CreateDefaultContext()
    labels = station.GetOutputPort("wrist_camera.label_image").Eval(context).data[:, :, 0]
    shown = labels == int(station.plant.GetBodyByName("wall").index())
    assert shown.mean() > 0.1
    cloud = station.GetOutputPort("wrist_camera.point_cloud").Eval(context)
    x = cloud.xyzs().T.reshape(*labels.shape, 3)[shown]
    np.testing.assert_allclose(x[np.isfinite(x).all(axis=1)][:, 0], 0.94, atol=2e-3)
    bodies = make_foreground_segmentation(setting, make_reachability(setting).gripper)._bodies
    X_WC = station.GetOutputPort("wrist_camera.pose").Eval(context).GetAsMatrix4()
    kinds = bodies.kinds(x, X_WC, setting.start, 0.1, 0.0)
    assert np.all(kinds == Kind.CELL)


@pytest.mark.parametrize("height", [-0.3, -0.1, 0.08])
def test_the_height_of_the_table_reaches_all_that_reckon_with_it(height):
    setting = own(f"{{cell: {{table_height: {height}, table_clearance: 0.05}}}}")
    reachability, boxes = make_reachability(setting), cell_boxes(station_config(setting))
    # Segmentation: the top of the one box there is.
    assert boxes.X_WB[0, 2, 3] + boxes.half[0, 2] == pytest.approx(height)
    assert boxes.solid.tolist() == [True]
    # The filter: of hands that point down, those are kept that are far enough above the table.
    down = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (60, 1, 1))
    z = down[:, 2, 3] = np.linspace(height - 0.05, height + 0.3, 60)
    down[:, 0, 3] = 0.5
    kept = reachability.reachable(down)
    tip = reachability.gripper.tip
    assert kept.any() and z[kept].min() >= height + 0.06 + 0.5 * tip - 0.02
    looser = make_reachability(own(f"{{cell: {{table_height: {height}}}}}")).reachable(down)
    assert z[looser].min() == pytest.approx(z[kept].min() - 0.04, abs=0.01)
    # The QP: an arm that is asked to go down stops above the table.
    q = reachability.nearest(down[[-1]], setting.start)[0][0]
    safety = make_controller(setting, reachability).safety
    lowest = lowered(safety, q, reachability.gripper, setting.control.period)
    assert height + 0.049 < lowest < height + 0.06


def lowered(safety, q, gripper, period):
    """Where the lowest point of an arm comes to rest that is asked to go straight down [m]."""
    qd = np.zeros(7)
    for _ in range(round(4.0 / period)):
        J = pose_and_jacobian(q, gripper.X_FG)[1]
        qd = safety.velocity(q, 0.0 * q, J, np.array([0, 0, 0, 0, 0, -0.2]), qd_last=qd)
        q = q + period * qd
    return float(table_distances(q, 0.0, capsule_model(gripper)).min())


def test_an_obstacle_in_the_arm_is_refused_by_name():
    with pytest.raises(ScenarioError, match="the obstacle post of cell is .* cm in the arm"):
        make_static_grid(own("{cell: {boxes: {post: {position: [0, 0, 0.34]}}}}"))
    assert make_static_grid(own("{}")) is None


class Turn(GraspController):
    """Turns the arm about the vertical, whatever there is to grasp."""

    def update(self, memory, inputs):
        return None

    def velocity(self, memory, inputs):
        return self.enforced(0.8 * np.eye(7)[0], inputs)


#: Where the hand of an arm comes by that turns.
BLOCK = "{cell: {boxes: {block: {size: [0.08, 0.08, 0.3], position: [0.11, 0.19, 0.7]}}}}"


#: The same in the directives, as a board: with a model, a pose, and whether the controller has it.
BOARD = """
directives:
- add_directives: {file: 'package://feasigrasp/iiwa/cell.dmd.yaml'}
- add_model: {name: board, file: 'package://feasigrasp/scene/wall.urdf'}
- add_weld: {parent: world, child: 'board::wall', X_PC: {translation: [0.11, 0.24, %g],
    rotation: !Rpy {deg: [%g, 0, 0]}}}
"""
UPRIGHT, LYING, UNMODELED = (0.3, 0), (0.75, -90), "\ncell: {unmodeled: [board]}"


@pytest.mark.parametrize(
    ("text", "scene", "given"),
    [
        (BLOCK, False, True),
        (BLOCK, True, True),
        (BLOCK, False, False),
        (BOARD % UPRIGHT, False, True),
        (BOARD % LYING, True, True),
        (BOARD % UPRIGHT + UNMODELED, False, None),
    ],
)
def test_the_arm_keeps_clear_of_a_body_in_its_way(text, scene, given, monkeypatch):
    """By the simulation's own geometry; an arm that is not given the body runs into it."""
    if given is False:
        monkeypatch.setattr("feasigrasp.systems.pipeline.make_static_grid", lambda _: None)
    setting = own(text)
    setting.scene.enabled = scene
    diagram = make_dynamic_grasp(setting, controller=Turn(make_reachability(setting)))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.0)
    log = diagram.GetSubsystemByName("log(obstacle_distance)").FindLog(simulator.get_context())
    if given:
        assert 0.01 < log.data().min() < 0.05  # it stops before the body, where it may
    else:
        assert log.data().min() < 0.0


def test_bodies_of_the_directives_are_named_in_words():
    with pytest.raises(ScenarioError, match="cell.unmodeled: .* no model 'bord'; do you mean"):
        make_static_grid(own(BOARD % UPRIGHT + "\ncell: {unmodeled: [bord]}"))
    with pytest.raises(ScenarioError, match="the obstacle board of cell is .* cm in the arm"):
        make_static_grid(own((BOARD % UPRIGHT).replace("0.11, 0.24", "0, 0")))


def test_a_table_at_another_height_than_the_controller_has_is_refused():
    text = """
directives:
- add_model: {name: iiwa, file: 'package://feasigrasp/iiwa/iiwa7.urdf'}
- add_weld: {parent: world, child: 'iiwa::iiwa_link_0'}
- add_model: {name: table, file: 'package://feasigrasp/iiwa/table.urdf'}
- add_weld: {parent: world, child: 'table::table_top', X_PC: {translation: [0, 0, -0.2]}}
"""
    with pytest.raises(ScenarioError, match="table at z = -0.2 .* give cell: {table_height: -0.2}"):
        cell_directives(own(text))
    cell_directives(own(text + "cell: {table_height: -0.2}"))


@pytest.mark.parametrize("q_start", [[0, 118, 0, 0, 0, 0, 0], [0, 60, 0, -119, 0, 100, 0]])
def test_an_arm_that_starts_in_itself_or_the_table_is_refused(q_start):
    own("{q_start: [0, -48.5, 0, -90.6, 0, 60, 0], cell: {table_height: 0.1}}")
    with pytest.raises(ScenarioError, match="q_start: the arm starts in itself or in the table"):
        own(f"{{q_start: {q_start}}}")
