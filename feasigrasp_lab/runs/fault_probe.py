"""Probes of fault runs: leaks of ground truth, and the time until rest."""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.fault import PoseFrozen, PoseNan
from feasigrasp.models.faults.images import CameraGone
from feasigrasp.models.faults.object import ObjectMoved
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.one_thread import one_thread
from feasigrasp.scenario.files import parse_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp


class ArmLog(NamedTuple):
    """The arm at every tick of the control.

    Attributes:
        times: [s], shape (m,).
        commanded: Joint velocities sent to it [rad/s], shape (m, 7).
        measured: Its true joint velocities [rad/s], shape (m, 7).
        handled: When it touched the object, in truth, or its fingers had closed on it [s], in
            order, shape (k,).
    """

    times: Array
    commanded: Array
    measured: Array
    handled: Array


def arm_log(scenario: Scenario) -> ArmLog:
    """Commands and motion of the arm in a scenario, until its duration is over."""
    with one_thread():
        diagram = make_dynamic_grasp(scenario)
        simulator = Simulator(diagram)
        ApplySimulatorConfig(scenario.simulator_config, simulator)
        handled = Handled(diagram)
        simulator.set_monitor(handled)
        simulator.AdvanceTo(scenario.simulation_duration)
    found = {
        name: diagram.GetSubsystemByName(f"log({name})").FindLog(simulator.get_context())
        for name in ("drive", "arm")
    }
    velocities = {name: log.data()[IIWA_7.joints :].T.copy() for name, log in found.items()}
    return ArmLog(
        found["arm"].sample_times().copy(),
        velocities["drive"],
        velocities["arm"],
        np.array(handled.times),
    )


class Handled:
    """A simulator's monitor that notes when arm or hand touch the object, or the fingers closed.

    Attributes:
        times: When that was so [s], in order.
    """

    def __init__(self, diagram: Diagram) -> None:
        """Watches a diagram of `make_dynamic_grasp`."""
        self.times: list[float] = []
        self._contact = diagram.GetSubsystemByName("contact")
        self._sequencer = diagram.GetSubsystemByName("sequencer")
        self._touched = 0.0

    def __call__(self, root: Context) -> EventStatus:
        """Called after every step of the simulation, with the diagram's context."""
        contact, sequencer = self._contact, self._sequencer
        approach = contact.GetOutputPort("approach").Eval(contact.GetMyContextFromRoot(root))
        phase = sequencer.GetOutputPort("phase").Eval(sequencer.GetMyContextFromRoot(root))[0]
        if approach[1] > self._touched or phase != Phase.APPROACH:
            self.times.append(root.get_time())
        self._touched = approach[1]
        return EventStatus.DidNothing()


def blind_pairs(scenario: Scenario) -> dict[str, tuple[Scenario, Scenario]]:
    """By name, two scenarios that differ only in what no sensor measures.

    In the first two the object's place differs and no pose is ever measured, so no view can be
    used either; in the others the object leaves to different places at an instant from which on
    there is no image and no new pose.
    """
    # When what is known of the object ends, and where it goes then, one way or the other, before
    # the arm could feel it [s], [m].
    blind_from, quickly, away = 0.5, 0.4, ([1.3, 0.3, 0.55], [1.3, -0.3, 0.55])
    plain = copy.deepcopy(scenario)
    plain.simulation_duration = 2.5
    nan, lost = (copy.deepcopy(plain) for _ in range(2))
    nan.faults = [PoseNan()]
    lost.tracker.dropout = 1.0
    pairs = {"pose_nan": (nan, _aside(nan)), "dropout": (lost, _aside(lost))}
    for name, kind in (("pose_nan_later", PoseNan), ("pose_frozen", PoseFrozen)):
        one, other = (copy.deepcopy(plain) for _ in range(2))
        for each, place in zip((one, other), away, strict=True):
            leaving = ObjectMoved(start=blind_from, to=place, ramp=quickly)
            each.faults = [kind(start=blind_from), CameraGone(start=blind_from), leaving]
        pairs[name] = one, other
    return pairs


def _aside(scenario: Scenario) -> Scenario:
    other = copy.deepcopy(scenario)
    other.motion.center[1] += 0.05
    return other


def leaks(texts: Sequence[str]) -> bool:
    """Whether the commands of two scenarios, given as text, differ in a single bit."""
    one, other = (arm_log(parse_scenario(text)).commanded for text in texts)
    return not np.array_equal(one, other)


class Rest(NamedTuple):
    """How long an arm goes on whose object is lost for good.

    Attributes:
        untouched_s: The longest that its command was in motion after the stated silence, or after
            the last touch since then [s]: an arm gives way to what pushes it.
        any_s: How long after the stated silence the arm was last in motion, pushed or not [s].
    """

    untouched_s: float
    any_s: float


def rest_times(text: str, lost_at: float) -> Rest:
    """How long after the stated silence the arm is in motion.

    An arm that has closed its fingers on the object by then goes on with it, and counts as touched.

    Args:
        text: A scenario, as text, in which no pose is measured from some time on.
        lost_at: That time [s]; from then on counts the scenario's ``tracker.silence``.
    """
    scenario = parse_scenario(text)
    return rest_of(arm_log(scenario), lost_at + scenario.tracker.silence)


def rest_of(log: ArmLog, due: float) -> Rest:
    """The same, by what the arm did, and when the stated silence ends [s]."""
    # A joint that turns more slowly than this is at rest [rad/s].
    moving, commanded = (
        log.times[(np.abs(speeds).max(axis=1) > 0.01) & (log.times > due)]
        for speeds in (log.measured, log.commanded)
    )
    # What a command follows that is in motion: the end of the silence, or a later touch.
    causes = np.concatenate([[due], log.handled[log.handled > due]])
    after = commanded - causes[np.searchsorted(causes, commanded, side="right") - 1]
    return Rest(float(after.max(initial=0.0)), float((moving - due).max(initial=0.0)))
