"""Recordings are played as a sensor would see them, and judged by the true surface."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp_lab.studies.tracking import FIGURES, summary_rows
from feasigrasp_lab.tracking import recording as module
from feasigrasp_lab.tracking.judge import TrueObject, judge, lost
from feasigrasp_lab.tracking.recording import RATE, SENSORS, Recording, images, recorded
from feasigrasp_lab.tracking.trackers import OurTracker, PeerTracker, point_to_plane_open3d
from feasigrasp_lab.training.data.raycasting import Raycaster
from tests.object_views import CAMERA, camera_at, look

TWIST = np.array([0.0, 0.1, 0.2, 0.02, -0.05, 0.01])
X_WC = camera_at(np.array([0.3, 0.1, 0.15]))


def make_recording(name, images_=24):
    """A still camera looks at an object that moves steadily."""
    obj = load_object(name)
    surface = Raycaster(obj.vertices, obj.faces)
    times = np.arange(images_) / RATE
    X_WO = np.array([se3.extrapolate(np.eye(4), TWIST, t) for t in times])
    depths = np.array([look(surface, X, X_WC).depth for X in X_WO])
    return Recording(
        times,
        np.round(depths / 1e-4).astype(np.uint16),
        depths < 1.0,
        np.repeat(X_WC[None], images_, axis=0),
        X_WO,
        np.repeat(TWIST[None], images_, axis=0),
        np.array(CAMERA.intrinsics),
        np.ones(images_, dtype=bool),
    )


@pytest.fixture(scope="module")
def mug():
    return make_recording("mug"), TrueObject(load_object("mug"))


@pytest.mark.parametrize("make", [OurTracker, lambda: PeerTracker(point_to_plane_open3d)])
def test_a_tracker_is_judged(mug, make):
    recording, truth = mug
    frames = judge({"it": make()}, recording, SENSORS["d435"], truth, 0)["it"]
    assert len(frames) == len(recording.times)
    assert frames[0].surface_mm == pytest.approx(0.0, abs=1e-3)  # aligned there, once
    late = frames[-6:]
    assert max(f.surface_mm for f in late) < 3.0
    assert not lost(frames)
    assert np.isnan(frames[-1].prediction_mm)  # the recording has ended by then
    assert frames[0].keyframe_ms > 0.0 and frames[-1].frame_ms > 0.0


def test_errors_are_those_that_were_made(mug):
    """A tracker that is off by a known shift, turn and twist."""
    recording, truth = mug
    shift, turn, k = np.array([0.0, 0.003, 0.0]), np.array([0.0, 0.0, 0.1]), iter(range(100))

    class Wrong:
        V_WO = TWIST + np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.02])

        def looked(self, view, time):
            number = next(k)
            X, wrong = recording.X_WO[number], number > 0
            R = se3.so3_exp(wrong * turn) @ X[:3, :3]
            self.X_WO = se3.make_pose(R, X[:3, 3] + wrong * shift)

        def learnt(self):
            return False

        def predicted(self, time, ahead):
            return self.X_WO

    frames = judge({"it": Wrong()}, recording, SENSORS["d435"], truth, 0)["it"]
    frame = frames[-1]
    assert frame.rotation_deg == pytest.approx(np.rad2deg(0.1), abs=1e-6)
    assert frame.speed_mm_s == pytest.approx(20.0)
    assert 0.5 < frame.surface_mm < 10.0


def test_a_turn_about_an_axis_of_symmetry_is_no_error():
    can, mug, ball = (TrueObject(load_object(name)) for name in ("soup_can", "mug", "ball"))
    assert [len(truth.axes) for truth in (can, mug, ball)] == [1, 0, 3]
    (axis,) = can.axes
    turned = se3.make_pose(se3.so3_exp(axis), np.zeros(3))
    assert can.surface_error(turned, np.eye(4)) < 5e-4
    across = 1e-3 * np.cross(axis, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        can.without_symmetric(0.3 * axis + across, np.eye(3)), across, atol=1e-12
    )
    np.testing.assert_array_equal(mug.without_symmetric(axis, np.eye(3)), axis)


def test_what_is_too_near_is_not_seen(mug):
    recording, _ = mug
    for _, view in images(recording, SENSORS["d435"], 0):
        assert len(view.points_W) > 300
    near = Recording(**{**vars(recording), "depths": (recording.depths * 0.2).astype(np.uint16)})
    _, view = next(images(near, SENSORS["d435"], 0))
    assert len(view.points_W) == 0
    assert view.depth.min() == 0.0


def test_a_recording_is_made_once_of_the_same(mug, tmp_path, monkeypatch):
    recording, _ = mug
    made = []
    monkeypatch.setattr(module, "record", lambda *what: made.append(what) or recording)
    file, mesh = tmp_path / "a.npz", tmp_path / "mesh.obj"
    mesh.write_text("one")
    for _ in range(2):
        again = recorded(file, "ReachLinearMocap", ("{}",), 1.0, mesh)
        assert np.array_equal(again.depths, recording.depths)
        assert again.depth(0).max() == pytest.approx(2.0)
    assert len(made) == 1
    for k, what in enumerate(
        [
            ("ReachCircularMocap", ("{}",), 1.0),
            ("ReachLinearMocap", ("{a: 1}",), 1.0),
            ("ReachLinearMocap", (), 2),
        ]
    ):
        recorded(file, *what, mesh)
        assert len(made) == 2 + k
    mesh.write_text("another")
    recorded(file, "ReachLinearMocap", (), 2, mesh)
    assert len(made) == 5


def test_rows_say_how_often():
    figures = {"object": "mug", "tracking.surface_mm.median": 1.0, "end_mm": 2.0}
    runs = [
        {"condition": c, "tracker": "default", "lost": gone, **figures}
        for c, gone in (("approach/d435", False), ("approach/d435", True), ("follow/d405", False))
    ]
    runs = [dict.fromkeys(name for _, name, _, _ in FIGURES) | run for run in runs]
    found = {(r.name, r.preset): r.value for r in summary_rows(runs)}
    assert found["tracking.lost_percent", "approach/d435/default"] == 50.0
    assert found["tracking.drift_mm.60s", "follow/d405/default"] == 2.0
