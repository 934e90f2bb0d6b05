"""The replay shows the completed surface and the grasps on the object, when they were true."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.runs.replay import FRAMES_PER_SECOND, start_recording, write_replay
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.monitoring.meshcat_view import (
    INVENTED,
    PATH,
    SEEN,
    GraspVisualizer,
    reachable_mask,
    surface_colors,
)
from feasigrasp.systems.point_cloud_to_gpdf import Perceived

OBJECT = "/drake/illustration/object/object"
SCENARIOS = Path(__file__).parents[3] / "diagrams" / "dynamic.scenarios.yaml"


def value_at(keys: list, time: float) -> Any:
    """The value of a stepwise track."""
    return [value for frame, value in keys if frame <= FRAMES_PER_SECOND * time][-1]


def half_sphere(radius: float = 0.04, n: int = 400) -> np.ndarray:
    """Evenly spread points on the half z > 0."""
    i = np.arange(n) + 0.5
    z, angle = i / n, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z**2)
    return radius * np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def perceive(points: np.ndarray) -> Perceived:
    cloud = FusedCloud.empty(0.003).merged(points, [0.0, 0.0, 1.0])
    return Perceived(cloud, fit_gpdf(cloud.points, viewpoint=cloud.directions))


def grasps(n: int) -> GraspSet:
    """n grasps from above, turned about z."""
    poses = [
        RigidTransform(
            RotationMatrix.MakeZRotation(a) @ RotationMatrix.MakeXRotation(np.pi), [0, 0, 0.02]
        )
        for a in np.linspace(0.0, 2.0, n)
    ]
    return GraspSet(
        np.array([X.GetAsMatrix4() for X in poses]).reshape(-1, 4, 4), np.full(n, 0.05), np.ones(n)
    )


class Dut:
    """A visualizer whose inputs a test sets."""

    def __init__(self, meshcat: Meshcat) -> None:
        self.system = GraspVisualizer(meshcat, ParallelGripper())
        self.simulator = Simulator(self.system)
        self.set(
            perceived=Perceived(FusedCloud.empty(0.003), None),
            grasps=GraspSet.empty(),
            reachable=GraspSet.empty(),
            phase=Phase.APPROACH,
            object_pose=RigidTransform(),
        )

    def set(self, **inputs: Any) -> None:
        context = self.simulator.get_mutable_context()
        for name, value in inputs.items():
            value = [float(value)] if name == "phase" else AbstractValue.Make(value)
            self.system.GetInputPort(name).FixValue(context, value)

    def advance(self, time: float) -> None:
        # Just past the time, so that what is published then is drawn.
        self.simulator.AdvanceTo(time + 1e-3)


def test_recording_shows_each_picture_while_it_is_true(tmp_path: Path, read_animation) -> None:
    meshcat = start_recording()
    dut = Dut(meshcat)
    dut.advance(0.25)
    assert not meshcat.HasPath(f"{PATH}/completion/0")
    some = grasps(6)
    dut.set(perceived=perceive(half_sphere()), grasps=some, reachable=some.select(np.arange(3)))
    dut.advance(0.5)
    assert meshcat.HasPath(f"{PATH}/completion/0")
    assert meshcat.HasPath(f"{PATH}/grasps/reachable/0")
    assert meshcat.HasPath(f"{PATH}/grasps/dropped/0")
    dut.advance(0.75)  # nothing changed, nothing new
    assert not meshcat.HasPath(f"{PATH}/completion/1")
    assert not meshcat.HasPath(f"{PATH}/grasps/reachable/1")
    dut.set(perceived=perceive(half_sphere(0.05)), reachable=some)
    dut.advance(1.0)
    dut.set(reachable=some.select(np.array([2])), phase=Phase.CLOSE)
    dut.advance(1.25)
    dut.set(phase=Phase.LIFT)
    dut.advance(1.5)

    filename = tmp_path / "sub" / "replay.html"
    write_replay(meshcat, filename)
    shown = {
        path.removeprefix(f"{PATH}/"): [
            bool(value_at(tracks["visible"], t)) for t in (0.0, 0.5, 0.75, 1.0, 1.25, 1.5)
        ]
        for path, tracks in read_animation(filename.read_text()).items()
        if "visible" in tracks
    }
    no, yes = False, True
    assert shown == {
        "completion/0": [no, yes, yes, no, no, no],
        "completion/1": [no, no, no, yes, yes, yes],
        "grasps/reachable/0": [no, yes, yes, no, no, no],
        "grasps/dropped/0": [no, yes, yes, no, no, no],
        "grasps/reachable/1": [no, no, no, yes, no, no],
        "grasps/reachable/2": [no, no, no, no, yes, no],
    }


def test_initialization_starts_over() -> None:
    meshcat = start_recording()
    dut = Dut(meshcat)
    dut.set(perceived=perceive(half_sphere()))
    dut.advance(0.0)
    assert meshcat.HasPath(f"{PATH}/completion/0")
    dut.set(perceived=Perceived(FusedCloud.empty(0.003), None))
    dut.simulator.get_mutable_context().SetTime(0.0)
    dut.simulator.Initialize()
    assert not meshcat.HasPath(f"{PATH}/completion/0")


def test_a_grasp_counts_as_reachable_by_its_flip_too() -> None:
    some = grasps(4)
    symmetric_grasps = some.with_symmetric()
    np.testing.assert_array_equal(
        reachable_mask(some, symmetric_grasps.select(np.array([1, 4 + 2]))),
        [False, True, True, False],
    )
    assert reachable_mask(GraspSet.empty(), GraspSet.empty()).shape == (0,)
    assert not reachable_mask(some, grasps(5).select(np.array([2]))).any()


def test_seen_side_has_the_colour_of_seen() -> None:
    points = half_sphere()
    gpdf = perceive(points).gpdf
    assert gpdf is not None
    colors, z = surface_colors(gpdf), gpdf.completion.points[:, 2]
    np.testing.assert_allclose(colors[z > 0.012].mean(axis=0), SEEN, atol=0.15)
    assert (z < -0.015).any()
    np.testing.assert_allclose(colors[z < -0.015].mean(axis=0), INVENTED, atol=0.05)


@pytest.mark.parametrize("name", ["ReachCircularMocap", "ReachCircular"])
def test_pipeline_draws_where_the_tracker_believes_the_object(
    name: str, tmp_path: Path, read_animation
) -> None:
    meshcat = start_recording()
    # Of this object, seen like this, the first view already tells of grasps.
    scenario = load_scenario(SCENARIOS, name, "{object: {model: soup_can}}")
    diagram = make_dynamic_grasp(scenario, meshcat)
    simulator = Simulator(diagram)
    simulator.Initialize()
    context = simulator.get_context()

    def pose(system: Any, port: str) -> RigidTransform:
        found = system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))
        return RigidTransform(found.GetAsMatrix4())  # a copy: Eval gives the cached value itself

    station, tracker = diagram.subsystems.station, diagram.subsystems.tracker
    at_start = pose(station, "object.pose")
    simulator.AdvanceTo(0.65)
    believed = pose(tracker, "object_pose")
    for path in ("completion/0", "grasps"):
        assert meshcat.HasPath(f"{PATH}/{path}")
    assert meshcat.HasPath("/drake/illustration/iiwa/iiwa_link_7")

    filename = tmp_path / "replay.html"
    write_replay(meshcat, filename)
    html = filename.read_text()
    assert "<script src=" not in html and "<link" not in html
    animation = read_animation(html)
    body, drawn = animation[OBJECT], animation[PATH]
    assert_is_at(body, 0, at_start, 1e-9)
    assert not np.allclose(body["position"][-1][1], at_start.translation(), atol=1e-3)
    # Half a picture later; the object moves by 2 mm in that time.
    assert_is_at(drawn, -1, believed, 4e-3)


def assert_is_at(tracks: dict[str, Any], frame: int, X: RigidTransform, atol: float) -> None:
    """Whether what is recorded is at a pose."""
    np.testing.assert_allclose(tracks["position"][frame][1], X.translation(), atol=atol)
    xyzw = np.roll(X.rotation().ToQuaternion().wxyz(), -1)
    assert abs(np.dot(tracks["quaternion"][frame][1], xyzw)) == pytest.approx(1.0, abs=atol)


def test_without_meshcat_nothing_is_drawn() -> None:
    diagram = make_dynamic_grasp(load_scenario(SCENARIOS, "ReachCircularMocap", None))
    assert not diagram.HasSubsystemNamed("visualizer")
    assert not diagram.HasSubsystemNamed("scene")
