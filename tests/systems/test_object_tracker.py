"""The tracker is exact when perfect, and late, noisy or silent as its configuration says."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.tracking import TrackerConfig, TrackingState
from feasigrasp.systems.object_tracker import ObjectTracker
from feasigrasp.systems.ports import evaluate, to_value

STILL = HarmonicMotion(
    center=np.array([0.5, -0.2, 0.3]),
    amplitude=np.zeros(3),
    harmonic=np.ones(3),
    offset_deg=np.zeros(3),
    rate=0.0,
    start_phase=0.0,
    spin_axis=np.array([0.0, 0.0, 1.0]),
    spin=0.0,
)
CIRCLE = HarmonicMotion(
    center=np.array([0.5, 0.0, 0.55]),
    amplitude=np.array([0.12, 0.12, 0.0]),
    harmonic=np.ones(3),
    offset_deg=np.array([90.0, 0.0, 0.0]),
    rate=0.2 * np.pi,
    start_phase=0.4,
    spin_axis=np.array([1.0, 2.0, 3.0]),
    spin=0.2,
)


class ConstantTwist:
    """Straight motion at constant speed while turning at constant speed."""

    twist = np.array([0.3, -0.2, 0.5, 0.1, 0.05, -0.2])

    def pose(self, t):
        w = self.twist[:3]
        R = RotationMatrix(AngleAxis(np.linalg.norm(w) * t, w / np.linalg.norm(w)))
        return RigidTransform(R, self.twist[3:] * t).GetAsMatrix4()

    def velocity(self, t):
        return self.twist


class PoseSource(LeafSystem):
    def __init__(self, motion):
        super().__init__()
        self._motion = motion
        self.evaluations = 0
        self.DeclareAbstractOutputPort("pose", Value[RigidTransform], self._calc)

    def _calc(self, context, output):
        self.evaluations += 1
        output.set_value(RigidTransform(self._motion.pose(context.get_time())))


class Tracked:
    """A tracker that watches a motion, with the simulator that runs it."""

    def __init__(self, motion, config=None):
        builder = DiagramBuilder()
        self.motion = motion
        self.source = builder.AddSystem(PoseSource(motion))
        self.tracker = builder.AddSystem(ObjectTracker(config))
        builder.Connect(self.source.get_output_port(), self.tracker.GetInputPort("pose"))
        self.simulator = Simulator(builder.Build())

    def at(self, t):
        """Estimated pose (4, 4) and twist (6,) at time t."""
        self.simulator.AdvanceTo(t)
        context = self.tracker.GetMyContextFromRoot(self.simulator.get_context())
        pose = self.tracker.GetOutputPort("object_pose").Eval(context)
        twist = self.tracker.GetOutputPort("object_velocity").Eval(context)
        return pose.GetAsMatrix4(), twist.get_coeffs()

    def _output(self, name):
        context = self.tracker.GetMyContextFromRoot(self.simulator.get_context())
        return evaluate(self.tracker.GetOutputPort(name), context)

    @property
    def tracking(self):
        return self._output("tracking")

    @property
    def motion_estimate(self):
        return self._output("object_motion")

    def motion_known(self):
        context = self.tracker.GetMyContextFromRoot(self.simulator.get_context())
        return self.tracker.GetOutputPort("object_motion").Eval(context).known

    def errors(self, times):
        """Position [m], angle [rad] and twist errors over time."""
        rows = []
        for t in times:
            X, V = self.at(t)
            X_true = self.motion.pose(t)
            R = RotationMatrix(X_true[:3, :3].T @ X[:3, :3])
            rows.append(
                [
                    np.linalg.norm(X[:3, 3] - X_true[:3, 3]),
                    abs(R.ToAngleAxis().angle()),
                    np.linalg.norm(V - self.motion.velocity(t)),
                ]
            )
        return np.array(rows).T


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(ObjectTracker())
    assert (list(inputs), list(outputs)) == documented_ports(ObjectTracker)


@pytest.mark.parametrize("latency", [0.0, 0.05])
def test_a_constant_twist_is_tracked_exactly(latency):
    tracked = Tracked(ConstantTwist(), TrackerConfig(latency=latency))
    # Off the ticks too: the pose in between is extrapolated.
    position, angle, twist = tracked.errors(latency + 0.1 + np.arange(20) * 0.0137)
    assert position.max() < 1e-9
    assert angle.max() < 1e-7
    assert twist.max() < 1e-7


def test_a_perfect_measurement_is_neither_smoothed_nor_late():
    tracked = Tracked(CIRCLE, TrackerConfig())
    position, angle, twist = tracked.errors(0.1 + np.arange(30) * 0.0221)
    # What is left is what a parabola over some ticks cannot know: the jerk, here 0.03 m/s^3.
    assert position.max() < 1e-7
    assert angle.max() < 1e-7
    assert twist.max() < 2e-5


def test_a_still_object_has_no_twist():
    X, V = Tracked(STILL).at(0.1)
    np.testing.assert_allclose(X, STILL.pose(0.0), atol=1e-12)
    np.testing.assert_allclose(V, 0.0, atol=1e-12)


def test_a_jump_is_seen_after_the_latency_and_not_before():
    class Jump:
        def pose(self, t):
            return RigidTransform([1.0 if t >= 0.1 else 0.0, 0.0, 0.0]).GetAsMatrix4()

    tracked = Tracked(Jump(), TrackerConfig(period=0.01, latency=0.05))
    seen = {t: tracked.at(t)[0][0, 3] for t in (0.095, 0.135, 0.145)}
    assert seen == {0.095: 0.0, 0.135: 0.0, 0.145: 0.0}
    assert not tracked.tracking.jumping
    tracked.at(0.175)
    assert tracked.tracking.jumping
    # A tenth of a second later it is believed. A jump is no motion: there is no velocity.
    assert tracked.at(0.245)[0][0, 3] == 0.0
    assert tracked.at(0.255)[0][0, 3] == pytest.approx(1.0)
    assert tracked.at(0.275)[0][0, 3] == pytest.approx(1.0)
    assert not tracked.tracking.jumping


def test_dropouts_are_bridged_by_extrapolation():
    config = TrackerConfig(dropout=0.7, seed=1)
    tracked = Tracked(ConstantTwist(), config)
    position, angle, twist = tracked.errors(0.2 + np.arange(40) * 0.0137)
    assert position.max() < 1e-9
    assert angle.max() < 1e-7
    assert twist.max() < 1e-7


def test_dropouts_make_gaps_on_a_curve():
    times = 0.3 + np.arange(60) * 0.01
    worst = [
        Tracked(CIRCLE, TrackerConfig(dropout=p, seed=2)).errors(times)[0].max() for p in (0.0, 0.8)
    ]
    assert worst[1] > 3 * worst[0]
    assert worst[1] < 0.005


@pytest.mark.parametrize(
    ("config", "until"), [({"latency": 0.5}, 0.5), ({"dropout": 1.0}, 3.0)], ids=str
)
def test_before_the_first_measurement_nothing_is_known(config, until):
    """Least of all the truth: neither pose nor twist is a number, and there is no prediction."""
    tracked = Tracked(CIRCLE, TrackerConfig(**config))
    for t in (0.0, 0.2, until - 0.01):
        X, V = tracked.at(t)
        assert np.isnan(X[:3]).all() and np.isnan(V).all()
        assert not tracked.motion_known()


def test_the_outputs_do_not_depend_on_the_true_pose():
    tracker = ObjectTracker(TrackerConfig())
    for name in ("object_pose", "object_velocity", "object_motion"):
        feeds = tracker.HasDirectFeedthrough(
            tracker.GetInputPort("pose").get_index(), tracker.GetOutputPort(name).get_index()
        )
        assert not feeds


@pytest.mark.parametrize("latency", [0.0, 0.05])
def test_the_first_measurement_is_of_the_start_and_as_noisy_as_all(latency):
    """It is there as soon as it can be, also for states that are updated at t = 0."""
    config = TrackerConfig(latency=latency, position_noise=0.01, rotation_noise=0.1, seed=5)
    tracked = Tracked(STILL, config)
    tracked.simulator.Initialize()
    X, _ = tracked.at(0.0)
    assert np.isfinite(X).all() == (latency == 0.0)
    X, _ = tracked.at(latency + 0.001)
    off = np.linalg.norm(X[:3, 3] - STILL.pose(0.0)[:3, 3])
    assert 1e-4 < off < 0.05
    assert np.abs(X[:3, :3] - STILL.pose(0.0)[:3, :3]).max() > 1e-3


def test_a_state_updated_at_the_start_knows_the_pose():
    """As perception is, which looks for the first time at t = 0."""

    class Watcher(LeafSystem):
        def __init__(self):
            super().__init__()
            self.seen = []
            self.port = self.DeclareAbstractInputPort("pose", Value[RigidTransform]())
            self.DeclareAbstractState(to_value(None))
            self.DeclarePeriodicUnrestrictedUpdateEvent(0.5, 0.0, self._look)

        def _look(self, context, state):
            self.seen.append((context.get_time(), self.port.Eval(context).translation().copy()))

    builder = DiagramBuilder()
    source, tracker, watcher = map(
        builder.AddSystem, (PoseSource(CIRCLE), ObjectTracker(), Watcher())
    )
    builder.Connect(source.get_output_port(), tracker.GetInputPort("pose"))
    builder.Connect(tracker.GetOutputPort("object_pose"), watcher.get_input_port())
    Simulator(builder.Build()).AdvanceTo(0.1)
    ((time, p_WO),) = watcher.seen
    assert time == 0.0
    np.testing.assert_allclose(p_WO, CIRCLE.pose(0.0)[:3, 3], atol=1e-9)


class Hidden:
    """A motion that cannot be measured for some time."""

    def __init__(self, start, end):
        self._times = start, end

    def pose(self, t):
        X = CIRCLE.pose(t)
        if self._times[0] < t < self._times[1]:
            X[:3, 3] = np.nan
        return X

    def velocity(self, t):
        return CIRCLE.velocity(t)


def test_after_the_stated_silence_the_pose_is_held_and_then_found_again():
    tracked = Tracked(Hidden(1.0, 2.0), TrackerConfig(silence=0.4))
    states = {}
    for t in (0.99, 1.05, 1.2, 1.395):
        X, V = tracked.at(t)
        states[t] = str(tracked.tracking.state)
        assert np.linalg.norm(X[:3, 3] - CIRCLE.pose(t)[:3, 3]) < 0.005
        assert np.linalg.norm(V) > 0.05
    assert states == {0.99: "tracking", 1.05: "tracking", 1.2: "coasting", 1.395: "coasting"}
    held = []
    for t in (1.42, 1.7, 1.99):
        X, V = tracked.at(t)
        assert tracked.tracking.lost
        np.testing.assert_array_equal(V, 0.0)
        assert not tracked.motion_estimate.known
        held.append(X)
    np.testing.assert_allclose(held[1:], held[:-1], atol=1e-12)
    # Where it was expected when the silence ended, no farther.
    assert np.linalg.norm(held[0][:3, 3] - CIRCLE.pose(1.4)[:3, 3]) < 0.005
    X, _ = tracked.at(2.3)
    assert tracked.tracking.state is TrackingState.TRACKING
    np.testing.assert_allclose(X, CIRCLE.pose(2.3), atol=1e-4)


NOISY = {"position_noise": 0.002, "rotation_noise": np.deg2rad(1.0)}


def test_noise_is_added_and_most_of_it_filtered_out():
    tracked = Tracked(STILL, TrackerConfig(**NOISY))
    position, angle, twist = tracked.errors(0.5 + np.arange(200) * 0.01)
    # Root mean squares of the measurement: sqrt(3) times the standard deviation of an axis.
    raw = np.sqrt(3.0) * np.array([0.002, np.deg2rad(1.0)])
    rms = np.sqrt([np.mean(position**2), np.mean(angle**2), np.mean(twist**2)])
    assert np.all(rms[:2] < 0.6 * raw)
    assert np.all(rms[:2] > 0.05 * raw)  # there is noise at all


def test_the_twist_is_far_better_than_that_of_a_difference():
    latency = 0.05
    tracked = Tracked(CIRCLE, TrackerConfig(latency=latency, **NOISY))
    _, _, twist = tracked.errors(1.0 + np.arange(200) * 0.011)
    rms = np.sqrt(np.mean(twist**2))
    over_20_ms = np.sqrt(2.0) * np.sqrt(3.0) * np.hypot(0.002, np.deg2rad(1.0)) / 0.02
    assert rms < 0.06 * over_20_ms


def test_a_lower_jerk_calms_the_twist():
    spread = []
    for jerk in (0.1, 10.0):
        tracked = Tracked(STILL, TrackerConfig(position_noise=1e-3, jerk=jerk))
        spread.append(np.std([tracked.at(0.5 + k * 0.01)[1][3:] for k in range(60)]))
    assert spread[0] < 0.3 * spread[1]


def test_the_future_is_that_of_the_pose_output():
    tracked = Tracked(CIRCLE, TrackerConfig())
    X_WO, _ = tracked.at(2.0031)
    context = tracked.tracker.GetMyContextFromRoot(tracked.simulator.get_context())
    motion = tracked.tracker.GetOutputPort("object_motion").Eval(context)
    now, later = motion.predict([0.0, 2.0])
    np.testing.assert_allclose(now, X_WO, atol=1e-12)
    np.testing.assert_allclose(later, CIRCLE.pose(4.0031), atol=5e-3)


def test_the_seed_decides_the_noise():
    def poses(seed):
        config = TrackerConfig(position_noise=1e-3, rotation_noise=1e-2, dropout=0.3, seed=seed)
        tracked = Tracked(CIRCLE, config)
        return np.array([tracked.at(0.05 * k)[0] for k in range(1, 5)])

    np.testing.assert_array_equal(poses(3), poses(3))
    assert np.abs(poses(3) - poses(4)).max() > 1e-4


@pytest.mark.parametrize("period", [0.005, 0.02])
def test_it_measures_at_its_rate_and_no_more(period):
    tracked = Tracked(STILL, TrackerConfig(period=period))
    tracked.simulator.AdvanceTo(0.2)
    assert tracked.source.evaluations == round(0.2 / period)
