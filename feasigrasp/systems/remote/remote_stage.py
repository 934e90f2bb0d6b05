"""Proxy of a stage that runs in another process."""

import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pydrake.systems.framework import Context, Diagram, EventStatus, LeafSystem, State, System

from feasigrasp.models.arrays import Frozen
from feasigrasp.systems.ports import ObjectState, declare_output, scalar, weakly
from feasigrasp.systems.remote.served import Served, inputs_of, is_vector, outputs_of
from feasigrasp.systems.remote.worker import Worker

#: What has been posted for so long without an answer is given up: perception has lapsed [s].
#: Source: guessed.
DEADLINE = 2.0


@dataclass(frozen=True, eq=False)
class _Arrived(Frozen):
    """What has come from the other process: the stage's outputs, and whether it is gone."""

    outputs: dict[str, Any]
    lapsed: bool = False


class RemoteStage(LeafSystem):
    """Proxy with the ports of a stage that runs in a separate process.

    .. pydrake_system::

        name: RemoteStage
        input_ports: [<port>, stamp]
        output_ports: [<port>, lapsed]

    Every ``period`` the values of the inputs are posted. With a ``latency``, the outputs are there
    at that simulated time after each post: the simulation waits for them, so that a run repeats bit
    for bit. Without, nothing waits: a view that comes while the process is busy is passed over, and
    `take`, which whoever advances the diagram calls, takes over what has arrived, the latest of it.
    ``stamp``, optional, V1, is when the present image was taken [s]: none is posted twice, and none
    from before time 0, without an object pose.
    ``lapsed``, V1, is 1 while the process has not answered for `DEADLINE`, or has died, until it
    does or another one is there in its place, which remembers what the first one did; meanwhile the
    outputs stay what they are.

    What is on its way is no part of the context, nor are the values sent to the process: a `Frozen`
    value is posted once.
    """

    def __init__(
        self, make: Callable[[], System], period: float, *, latency: float | None = None
    ) -> None:
        """Starts the process, and builds the stage here as well, for its ports.

        Views are ``period`` [s] apart. ``make`` can be imported, and its arguments pickled. Results
        are there after the simulated time ``latency`` [s]; None takes them as they come.
        """
        super().__init__()
        self.worker = Worker(make)
        weakref.finalize(self, self.worker.close)  # at the latest when Python ends
        self._latency = latency
        stage = make()
        self._given = [self._mirrored(port) for port in inputs_of(stage)]
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        self._posted: deque[tuple[float, float]] = deque()  # when, and when the image was taken
        self._known: dict[str, Any] = {}  # what was last posted to the process
        self._last_stamp = 0.0
        arrived = self._arrived = ObjectState(self, _Arrived(Served(stage).outputs()))
        for port in outputs_of(stage):
            self._declare(port)
        declare_output(self, "lapsed", lambda of: arrived.Eval(of).lapsed, {arrived}, size=1)
        self.DeclarePeriodicPublishEvent(period, 0.0, weakly(self._post))
        if latency is not None:
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, latency, weakly(self._await))

    def take(self, context: Context, time: float) -> list[float]:
        """Takes the results that have arrived at a time [s] into the context, without waiting.

        The result is the latency from image to ``time`` [s] of every one with other grasps.
        """
        self.worker.end_if_stuck()
        before = arrived = self._arrived.Eval(context)
        latencies = []
        for answer in self.worker.answers():
            _, taken_at = self._posted.popleft()
            if answer is None:
                self._known = {}
            if answer:
                arrived = replace(arrived, outputs=arrived.outputs | answer)
                latencies += [time - taken_at] if "grasps" in answer else []
        overdue = bool(self._posted) and time - self._posted[0][0] > DEADLINE
        lapsed = overdue or not self.worker.ready.is_set()
        if lapsed != arrived.lapsed:
            arrived = replace(arrived, lapsed=lapsed)
        if arrived is not before:
            self._arrived.set(context, arrived)
        return latencies

    def _mirrored(self, port):
        if is_vector(port):
            return self.DeclareVectorInputPort(port.get_name(), port.size())
        return self.DeclareAbstractInputPort(port.get_name(), port.Allocate())

    def _declare(self, port) -> None:
        name = port.get_name()

        def value(context: Context) -> Any:
            return self._arrived.Eval(context).outputs[name]

        if is_vector(port):
            declare_output(self, name, value, {self._arrived}, size=port.size())
        else:
            model = port.Allocate().get_value()
            declare_output(self, name, value, {self._arrived}, model=model)

    def _post(self, context: Context) -> EventStatus:
        time = context.get_time()
        stamp = scalar(self._stamp, context, time)
        if self._stamp.HasValue(context) and not stamp > self._last_stamp:  # NaN is not, either
            return EventStatus.DidNothing()
        if self._latency is None and self.worker.busy:
            return EventStatus.DidNothing()
        self._last_stamp = stamp
        self._posted.append((time, stamp))
        there = [port for port in self._given if port.HasValue(context)]
        values = {port.get_name(): port.Eval(context) for port in there}
        # Fields are large, and the same for many posts; other values may have changed in place.
        known = self._known.get
        new = {k: v for k, v in values.items() if not (isinstance(v, Frozen) and v is known(k))}
        self.worker.post(time, new)
        self._known = values
        return EventStatus.Succeeded()

    def _await(self, context: Context, state: State) -> EventStatus:
        # Not every image that was due has come, and nothing is waited for that was not posted.
        late = context.get_time() - self._latency + 1e-9
        if not self._posted or self._posted[0][0] > late:
            return EventStatus.DidNothing()
        self._posted.popleft()
        answer = self.worker.next_answer()
        if not answer:
            return EventStatus.DidNothing()
        arrived = self._arrived.Eval(context)
        self._arrived.set(state, replace(arrived, outputs=arrived.outputs | answer))
        return EventStatus.Succeeded()


def end_processes(diagram: Diagram) -> None:
    """Ends the processes of a diagram's remote stages; its context becomes read-only."""
    for stage in remote_stages(diagram):
        stage.worker.close()


def remote_stages(diagram: Diagram) -> list[RemoteStage]:
    """Those of a diagram's systems."""
    return [system for system in diagram.GetSystems() if isinstance(system, RemoteStage)]
