"""State machine of a grasp: phases, conditions, and the target of the hand in each phase.

approach -> close -> lift -> shake -> hold -> done; back to approach when the fingers close on
nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.choices import key
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet

#: Predicted poses of an object (k, 4, 4) and their times from some instant on (k,) [s].
Path = Callable[[ArrayLike], Array]
#: Pose and twist of an object without a tracker. Source: layout.
_UNKNOWN = np.full((4, 4), np.nan), np.full(6, np.nan)


class Phase(IntEnum):
    """Phase of a grasp."""

    APPROACH = 0
    CLOSE = 1
    LIFT = 2
    SHAKE = 3
    HOLD = 4
    DONE = 5


@dataclass
class GraspSequenceConfig:
    """Conditions and durations of the phases of a grasp.

    Attributes:
        close: Whether the gripper closes at all; if not, the arm follows for ever.
        standoff: How far behind a grasp a hand that does not close follows [m]; with 0 the object
            is between its fingers.
        position_tolerance: Distance to a grasp below which the hand is there [m].
        angle_tolerance: The same for the angle [rad].
        dwell: How long the hand must be there before the fingers close [s].
        patience: A hand that has come no nearer to any grasp for so long gives the nearest one up
            for a while [s].
        closing_speed: Rate at which the distance between the pads shrinks [m/s].
        closing_time: Fingers that have not stopped by then are taken to have closed [s].
        squeeze_time: How long fingers that have stopped press with all their force before the
            carrier is asked to let go [s].
        handover_time: How long the hand goes on along the object's path from then on, before it
            lifts: a carrier needs some time to let go [s].
        min_width: Fingers that come closer than this have missed the object [m].
        lift: Displacement of the hand after that, in the world [m]; on the way an object that was
            moving comes to rest.
        lift_time: Duration of the lift [s].
        shake: Amplitude of the shaking that follows, in the world [m].
        shake_frequency: How often it goes to and fro [Hz].
        shake_time: Duration of the shaking [s]; 0 leaves it out.
        hold_time: Time the object must stay in the hand afterwards [s].
    """

    close: bool = True
    standoff: float = key(0.0, 0.0, 0.3, "m")
    position_tolerance: float = key(0.006, 0.0001, 0.1, "m")
    angle_tolerance: float = key(0.08, 0.001, 3.15, "rad")
    dwell: float = key(0.1, 0.0, 60.0, "s")
    patience: float = key(5.0, 0.5, 100000.0, "s")
    closing_speed: float = key(0.15, 0.001, 1.0, "m/s")
    closing_time: float = key(1.0, 0.01, 60.0, "s")
    squeeze_time: float = key(0.2, 0.01, 60.0, "s")
    handover_time: float = key(0.4, 0.0, 60.0, "s")
    min_width: float = key(0.002, 0.0, 0.2, "m")
    lift: list[float] = key([-0.05, 0.0, 0.10], -1.0, 1.0, "m")
    lift_time: float = key(1.5, 0.01, 60.0, "s")
    shake: list[float] = key([0.01, 0.01, 0.01], -0.5, 0.5, "m")
    shake_frequency: float = key(1.5, 0.01, 20.0, "Hz")
    shake_time: float = key(1.5, 0.0, 60.0, "s")
    hold_time: float = key(2.0, 0.0, 600.0, "s")

    def at_speed(self, speed: float) -> "GraspSequenceConfig":
        """The configuration for an arm at a share of its velocity limits, in (0, 1].

        Lift and shaking take as much longer, so that they ask for the same share of what the arm
        may do, and a hand that gets nearer more slowly is given as much more time for it. The
        fingers close as they did.
        """
        return replace(
            self,
            patience=self.patience / speed,
            lift_time=self.lift_time / speed,
            shake_time=self.shake_time / speed,
            shake_frequency=self.shake_frequency * speed,
        )

    @property
    def tolerances(self) -> Array:
        """``position_tolerance`` [m] and ``angle_tolerance`` [rad]."""
        return np.array([self.position_tolerance, self.angle_tolerance])


@dataclass(frozen=True, eq=False)
class GraspState(Frozen):
    """State of the grasp sequence.

    Attributes:
        phase: The present phase.
        since: When it began [s].
        near_since: Since when the hand has been at a grasp [s]; NaN if it is not.
        pressing_since: Since when the fingers have been pressing [s]; NaN until they stop.
        let_go_since: Since when the carrier has been asked to let go [s]; NaN before.
        grasp: The grasp that the hand committed to, in O; None while approaching.
        X_WO: Object pose, as the hand has it, when this phase began, or the lift before it, shape
            (4, 4); None while approaching.
        V_WO: Its twist then, shape (6,).
        path: Predicts its poses from then on; None where nothing but its twist is known.
    """

    phase: Phase = Phase.APPROACH
    since: float = 0.0
    near_since: float = float("nan")
    pressing_since: float = float("nan")
    let_go_since: float = float("nan")
    grasp: GraspSet | None = None
    X_WO: Array | None = None
    V_WO: Array | None = None
    path: Path | None = None

    @property
    def released(self) -> bool:
        """Whether the carrier has been asked to let the object go."""
        return self.phase > Phase.CLOSE or not np.isnan(self.let_go_since)

    def advanced(
        self,
        t: float,
        X_WH: Array,
        X_WO: Array,
        V_WO: Array,
        grasps: GraspSet,
        fingers: ArrayLike,
        config: GraspSequenceConfig,
        path: Path | None = None,
    ) -> "GraspState":
        """The state at time t.

        Of a hand with its grasp frame at X_WH (4, 4), with the measured distance between its pads
        [m] and the rate of it [m/s], (2,), an object at X_WO (4, 4) with the twist V_WO [angular;
        linear] (6,), and reachable grasps in O. An object whose pose or twist is not finite is
        neither grasped nor let go. The path predicts where it would be while the fingers close;
        without one, it goes on with its twist.
        """
        elapsed = t - self.since
        known = np.isfinite(X_WO).all() and np.isfinite(V_WO).all()
        if not self.released and not known:
            return replace(self, near_since=float("nan"))
        match self.phase:
            case Phase.APPROACH if config.close:
                state = self._approach(t, se3.inverse(X_WO) @ X_WH, grasps, config)
                if state.phase == Phase.CLOSE:
                    state = replace(state, X_WO=X_WO, V_WO=V_WO, path=path)
                return state
            case Phase.CLOSE:
                return self._close(t, np.asarray(fingers), config)
            case Phase.LIFT if elapsed >= config.lift_time - 1e-9:
                after = Phase.SHAKE if config.shake_time > 0.0 else Phase.HOLD
                return replace(self, phase=after, since=t)
            case Phase.SHAKE if elapsed >= config.shake_time - 1e-9:
                return replace(self, phase=Phase.HOLD, since=t)
            case Phase.HOLD if elapsed >= config.hold_time - 1e-9:
                return replace(self, phase=Phase.DONE, since=t)
        return self

    def _approach(
        self, t: float, X_OH: Array, grasps: GraspSet, config: GraspSequenceConfig
    ) -> "GraspState":
        if len(grasps) == 0:
            return replace(self, near_since=float("nan"))
        nearest, errors = _nearest(grasps, X_OH, config)
        if (errors > config.tolerances).any():
            return replace(self, near_since=float("nan"))
        near_since = t if np.isnan(self.near_since) else self.near_since
        if t - near_since < config.dwell - 1e-9:
            return replace(self, near_since=near_since)
        return GraspState(Phase.CLOSE, t, grasp=grasps.select(np.array([nearest])))

    def _close(self, t: float, fingers: Array, config: GraspSequenceConfig) -> "GraspState":
        opening, rate = fingers
        state = replace(
            self, pressing_since=pressing_since(self.pressing_since, t, t - self.since, rate)
        )
        if np.isnan(state.let_go_since):
            if not has_closed(t, self.since, state.pressing_since, config):
                return state
            if opening < config.min_width:
                return GraspState(since=t)
            state = replace(state, let_go_since=t)
        if t - state.let_go_since < config.handover_time - 1e-9:
            return state
        # On from where the hand is going: what the fingers did to the object is no error to mend.
        X_WO, V_WO = self.target(t, *_UNKNOWN, config)
        return GraspState(Phase.LIFT, t, grasp=self.grasp, X_WO=X_WO, V_WO=V_WO)

    def target(
        self, t: float, X_WO: Array, V_WO: Array, config: GraspSequenceConfig
    ) -> tuple[Array, Array]:
        """Pose and twist of the object that the arm should follow.

        While approaching it is the object itself. While the fingers close it is where the object
        would be without them: following its measured pose, the hand would give way to the very
        push of its own fingers; going on with the twist of the moment of closing, it would pull at
        an object that turns off, which slides in the fingers. Then it is the last of these poses,
        moved along the lift, and to and fro. The lift begins with the twist of that moment: an
        object that was stopped at once would slide on.
        """
        # Over this time a predicted pose is differentiated [s].
        step = 1e-3
        if self.X_WO is None or self.V_WO is None:
            return X_WO, V_WO
        elapsed = t - self.since
        if self.phase == Phase.CLOSE:
            if self.path is None:
                return se3.extrapolate(self.X_WO, self.V_WO, elapsed), self.V_WO
            X, after = self.path([elapsed, elapsed + step])
            turning = se3.so3_log(after[:3, :3] @ X[:3, :3].T)
            return X, np.concatenate([turning, after[:3, 3] - X[:3, 3]]) / step
        lifting = self.phase == Phase.LIFT
        moved, V = _lifted(elapsed if lifting else np.inf, self.V_WO, config)
        if self.phase == Phase.SHAKE:
            moved[3:], V[3:] = np.add([moved[3:], V[3:]], _shaken(elapsed, config))
        X = self.X_WO.copy()
        X[:3, :3] = se3.so3_exp(moved[:3]) @ X[:3, :3]
        X[:3, 3] += moved[3:]
        return X, V


@dataclass(frozen=True, eq=False)
class CommittedMotion(Frozen):
    """Planned motion of a committed object: targets of all phases to come.

    Fingers that close are taken to need ``closing_time``, and ``handover_time`` after it: an
    object that goes on longer than it does is no harm to a plan.

    Attributes:
        state: Where the sequence is; committed.
        time: Now [s].
        config: Durations of the phases.
    """

    state: GraspState
    time: float
    config: GraspSequenceConfig
    known: ClassVar[bool] = True  # a prediction is always available

    def predict(self, ahead: ArrayLike, v_WO: ArrayLike | None = None) -> Array:
        """Poses (k, 4, 4) of the object at times (k,) [s] from now, independent of its velocity."""
        to_come, poses = self._to_come(), []
        for t in self.time + np.asarray(ahead, dtype=float).reshape(-1):
            state = next(state for end, state in to_come if t < end)
            poses.append(state.target(t, *_UNKNOWN, self.config)[0])
        return np.array(poses).reshape(-1, 4, 4)

    def _to_come(self) -> list[tuple[float, GraspState]]:
        """This state and those that come, each with the time until which it lasts [s]."""
        state, config, states = self.state, self.config, []
        for phase, lasts in (
            (Phase.CLOSE, config.closing_time + config.handover_time),
            (Phase.LIFT, config.lift_time),
            (Phase.SHAKE, config.shake_time),
        ):
            if state.phase == phase:
                end = state.since + lasts
                states.append((end, state))
                X_WO, V_WO = state.X_WO, state.V_WO
                if phase == Phase.CLOSE:
                    X_WO, V_WO = state.target(end, *_UNKNOWN, config)
                state = replace(state, phase=Phase(phase + 1), since=end, X_WO=X_WO, V_WO=V_WO)
        return [*states, (np.inf, state)]


def unmet_condition(
    X_OH: Array, grasps: GraspSet, config: GraspSequenceConfig, *, measured: bool = True
) -> str:
    """The condition for closing the fingers that an approaching hand does not meet, in words.

    Of a hand at X_OH (4, 4) and grasps in O, at least one, that its fingers may close at. The
    object's pose is ``measured`` at present, or extrapolated.
    """
    if not config.close:
        return ""
    if not measured:
        return "the object's pose is extrapolated; closes when it is measured"
    _, errors = _nearest(grasps, X_OH, config)
    units = ((1e3, "mm"), (np.rad2deg(1.0), "deg"))
    unmet = [
        f"{scale * error:.0f} {unit} off the nearest grasp (closes at {scale * most:.0f})"
        for error, most, (scale, unit) in zip(errors, config.tolerances, units, strict=True)
        if error > most
    ]
    return "; ".join(unmet) or f"at a grasp, closes after {config.dwell:g} s there"


def _nearest(grasps: GraspSet, X_OH: Array, config: GraspSequenceConfig) -> tuple[int, Array]:
    """Index of the grasp whose errors are the least share of their tolerances, and these, (2,)."""
    errors = grasp_errors(grasps.X_OG, X_OH)
    nearest = int(np.argmin(np.max(errors / config.tolerances, axis=1)))
    return nearest, errors[nearest]


def pressing_since(before: float, t: float, elapsed: float, rate: float) -> float:
    """Time since which closing fingers press [s]; NaN until their first stop.

    Given are the same a moment ago, the time, that since the command to close [s], and the rate of
    the distance between the fingers [m/s].
    """
    # Fingers have stopped if the distance between them shrinks by less [m/s]; what is reported of
    # them so soon after the command to close is from before they moved [s].
    stopped_speed, take_off = 0.01, 0.2
    if elapsed < take_off - 1e-9:
        return before
    stopped = rate > -stopped_speed
    if np.isnan(before):
        return t if stopped else before
    return before if stopped else t


def has_closed(t: float, since: float, pressing: float, config: GraspSequenceConfig) -> bool:
    """Whether fingers that close since some time, and press since another, are done at time t."""
    return t - since >= config.closing_time - 1e-9 or t - pressing >= config.squeeze_time - 1e-9


def _lifted(elapsed: float, V: Array, config: GraspSequenceConfig) -> tuple[Array, Array]:
    """Displacement and twist [angular; linear] of the lift, which begins with the twist V.

    Cubics of time that end at rest; with the lift's T, and t = min(T, 1.5 s)::

        lift (3 s^2 - 2 s^3) + V t (r - 2 r^2 + r^3),    s = elapsed / T,  r = elapsed / t
    """
    lift, T = np.concatenate([np.zeros(3), config.lift]), config.lift_time
    # An object comes to rest after this, 4/27 of it times its speed away [s]. Source: guessed.
    t = min(T, 1.5)
    s, r = min(1.0, elapsed / T), min(1.0, elapsed / t)
    moved = lift * (3.0 * s**2 - 2.0 * s**3) + V * (t * r * (1.0 - r) ** 2)
    return moved, lift * (6.0 * s * (1.0 - s) / T) + V * ((1.0 - r) * (1.0 - 3.0 * r))


def _shaken(elapsed: float, config: GraspSequenceConfig) -> tuple[Array, Array]:
    """Displacement [m] and velocity [m/s] of the shaking, a sine that swells and fades.

    It swells in the first quarter of its time by ``w(s) = 6 s^5 - 15 s^4 + 10 s^3`` and fades
    likewise in the last, so that velocity and acceleration begin and end with zero.
    """
    quarter, turn = config.shake_time / 4.0, 2.0 * np.pi * config.shake_frequency
    left = config.shake_time - elapsed
    s = float(np.clip(min(elapsed, left) / quarter, 0.0, 1.0))
    w = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    dw = 30.0 * s**2 * (1.0 - s) ** 2 / quarter * (1.0 if elapsed < left else -1.0)
    sine, cosine = np.sin(turn * elapsed), np.cos(turn * elapsed)
    amplitude = np.asarray(config.shake, dtype=float)
    return amplitude * w * sine, amplitude * (dw * sine + w * turn * cosine)
