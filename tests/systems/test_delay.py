"""Values that arrive some time after they were made."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output, evaluate
from feasigrasp.systems.stages.delay import Delay

PERIOD = 0.005


class Maker(LeafSystem):
    """Makes value ``k`` at the time ``times[k]``, as an object and as a vector."""

    def __init__(self, times):
        super().__init__()
        self._times = np.array(times)
        self._made = PeriodicState(self, -1, PERIOD, self._newest)
        declare_output(self, "object", self._made.Eval, {self._made.ticket()})
        self.DeclareVectorOutputPort("vector", 1, self._calc_vector, {self._made.ticket()})

    def _newest(self, context):
        return int(np.sum(self._times <= context.get_time() + 1e-9)) - 1

    def _calc_vector(self, context, y):
        made = self._made.Eval(context)
        y.SetFromVector([np.nan if made < 0 else float(made)])


class Stamps(LeafSystem):
    """When that was taken of which the present value is made."""

    def __init__(self, times, age):
        super().__init__()
        self._stamps = np.array(times) - age
        self._made = declare_input(self, "made")
        self.DeclareVectorOutputPort("stamp", 1, self._calc)

    def _calc(self, context, stamp):
        made = evaluate(self._made, context)
        stamp.SetFromVector([np.nan if made < 0 else self._stamps[made]])


def arrivals(times, latency, kind, duration, period=PERIOD, age=None):
    """When each value is first seen behind a delay [s], by value; looked at after each tick.

    With an age [s], each is of something that was that old when it was made.
    """
    initial = np.array([np.nan]) if kind == "vector" else None
    builder = DiagramBuilder()
    maker, delay = (
        builder.AddSystem(Maker(times)),
        builder.AddSystem(Delay(initial, latency, period)),
    )
    builder.Connect(maker.GetOutputPort(kind), delay.GetInputPort("u"))
    stamps = builder.AddSystem(Stamps(times, age or 0.0))
    builder.Connect(maker.GetOutputPort("object"), stamps.get_input_port())
    if age is not None:
        builder.Connect(stamps.get_output_port(), delay.GetInputPort("stamp"))
    simulator, found = Simulator(builder.Build()), {}
    for k in range(round(duration / PERIOD) + 1):
        simulator.AdvanceTo(k * PERIOD)
        simulator.AdvancePendingEvents()  # those of this very instant
        context = delay.GetMyContextFromRoot(simulator.get_context())
        y = evaluate(delay.GetOutputPort("y"), context)
        value = float(y[0]) if kind == "vector" else y
        if value is not None and value >= 0:
            found.setdefault(int(value), k * PERIOD)
    return found


@pytest.mark.parametrize("kind", ["object", "vector"])
@pytest.mark.parametrize("latency", [0.02, 0.1, 0.7, 1.0])
def test_every_value_arrives_latency_after_it_was_made(kind, latency):
    """The values come at no period, and several of them are on their way at once."""
    made = [0.0, 0.035, 0.06, 0.51, 0.515, 1.2]
    found = arrivals(made, latency, kind, duration=2.4)
    assert sorted(found) == list(range(len(made)))
    np.testing.assert_allclose(
        [found[k] for k in range(len(made))], np.add(made, latency), atol=1e-9
    )


@pytest.mark.parametrize(("age", "wait"), [(0.06, 0.04), (0.3, 0.005)])
def test_the_latency_counts_from_the_stamp(age, wait):
    """From the exposure, that is; what has taken longer is there as soon as it is noticed."""
    made = [0.0, 0.1, 0.31]
    found = arrivals(made, 0.1, "object", duration=1.0, age=age)
    np.testing.assert_allclose([found[k] for k in range(3)], np.add(made, wait), atol=1e-9)


@pytest.mark.parametrize("kind", ["object", "vector"])
def test_without_latency_it_holds_what_there_was_at_the_last_tick(kind):
    found = arrivals([0.0, 0.03, 0.11], 0.0, kind, duration=0.5, period=0.1)
    # Made at a tick, a value is taken at the next: systems step by what there was before.
    np.testing.assert_allclose([found[k] for k in sorted(found)], [0.1, 0.2])
    assert sorted(found) == [1, 2]  # the first was gone when it looked


def test_until_something_arrives_it_hands_on_the_initial_value():
    delay = Delay(np.array([7.0, 8.0]), 0.1, PERIOD)
    simulator = Simulator(delay)
    context = simulator.get_mutable_context()
    delay.GetInputPort("u").FixValue(context, [1.0, 2.0])
    simulator.AdvanceTo(0.09)
    np.testing.assert_array_equal(delay.GetOutputPort("y").Eval(context), [7.0, 8.0])
    simulator.AdvanceTo(0.11)
    np.testing.assert_array_equal(delay.GetOutputPort("y").Eval(context), [1.0, 2.0])
