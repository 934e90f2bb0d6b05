"""Declares abstract ports, caches and states from functions; adds systems with their inputs."""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Callable, Collection
from enum import Enum
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import (
    BasicVector,
    CacheEntry,
    Context,
    DependencyTicket,
    Diagram,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
    System,
    ValueProducer,
)

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import Check, check_of
from feasigrasp.models.arrays import Array
from feasigrasp.models.quantities import Call, Refusal

Calc = Callable[[Context], Any]
#: What an output or a cache entry can depend on.
Source: TypeAlias = "InputPort | ObjectInput | Cached | ObjectState | DependencyTicket"
_System = TypeVar("_System", bound=System)


class Nothing(Enum):
    """Placeholder for None in abstract ports and states, which Drake 1.58 refuses."""

    NOTHING = "nothing"

    def __bool__(self) -> Literal[False]:
        return False


def to_value(value: Any) -> AbstractValue:
    """An abstract value of the type of ``value``; with None, one for any Python object."""
    return AbstractValue.Make(_stored(value))


def evaluate(source: InputPort | ObjectInput | OutputPort | Cached, context: Context) -> Any:
    """The value of a port or cache entry; None where it holds `Nothing`."""
    return _read(source.Eval(context))


def optional(port: InputPort | ObjectInput, context: Context) -> Any:
    """As `evaluate`; None also if nothing is connected to the input port."""
    return evaluate(port, context) if port.HasValue(context) else None


def scalar(port: InputPort, context: Context, default: float) -> float:
    """The number at an input port (V1); ``default`` if nothing is connected to it."""
    return float(port.Eval(context)[0]) if port.HasValue(context) else default


def same_value(a: Any, b: Any) -> bool:
    """Whether two values of a port are the same object, or equal vectors."""
    return a is b or (isinstance(a, np.ndarray) and np.array_equal(a, b, equal_nan=True))


class ObjectInput:
    """An input port for Python objects of one kind, which refuses others by name when it is read.

    Drake compares the types of its own values when they are given; to it, all of these are alike.
    """

    def __init__(self, port: InputPort, check: Check) -> None:
        self._port, self._check = port, check

    def Eval(self, context: Context) -> Any:
        """The value; None where it holds `Nothing`.

        Raises:
            ArgumentError: It is of another kind.
        """
        try:
            return self._check(_read(self._port.Eval(context)), Call())
        except Refusal as refusal:
            port = f"{self._port.get_name()} of {type(self._port.get_system()).__name__}"
            raise ArgumentError(f"input port {port} {refusal}") from None

    def HasValue(self, context: Context) -> bool:
        """Whether something is connected to it."""
        return bool(self._port.HasValue(context))

    def ticket(self) -> DependencyTicket:
        """Dependency ticket."""
        return self._port.ticket()


def declare_input(
    system: LeafSystem, name: str, model: Any = None, *, kind: Any = None
) -> InputPort | ObjectInput:
    """An input port for values of the type of ``model``; for Python objects if that is None.

    Those have to satisfy the annotation ``kind`` (see `feasigrasp.models.arguments`); unless it is
    given, they have the type of ``model``, or any.
    """
    value = to_value(model)
    port = system.DeclareAbstractInputPort(name, value)
    if kind is None and model is not None:
        kind = type(model)
    check = check_of(kind) if isinstance(value, Value[object]) and kind is not None else None
    return port if check is None else ObjectInput(port, check)


def declare_output(
    system: LeafSystem,
    name: str,
    calc: Calc,
    prerequisites: Collection[Source] = (),
    *,
    model: Any = None,
    size: int | None = None,
) -> OutputPort:
    """An output port whose value ``calc`` returns, of the type of ``model`` (see `declare_input`).

    With a ``size`` it is a vector of that length. Without ``prerequisites`` it depends on
    everything.
    """
    tickets = _tickets(prerequisites) or {system.all_sources_ticket()}
    if size is not None:

        def numbers(context: Context, output: BasicVector) -> None:
            output.SetFromVector(np.ravel(np.asarray(calc(context), dtype=float)))

        return system.DeclareVectorOutputPort(name, size, _kept_by(system, numbers), tickets)
    setting = _kept_by(system, _setting(calc))
    return system.DeclareAbstractOutputPort(name, to_value(model).Clone, setting, tickets)


def declare_pose_and_velocity(
    system: LeafSystem, calc: Callable[[Context], tuple[Array, Array]], inputs: Collection[Source]
) -> None:
    """The output ports ``object_pose`` and ``object_velocity``, of X_WO (4, 4) and V_WO (6,)."""

    def pose(context: Context) -> RigidTransform:
        return RigidTransform(calc(context)[0])

    def velocity(context: Context) -> SpatialVelocity:
        return SpatialVelocity(calc(context)[1])

    declare_output(system, "object_pose", pose, inputs, model=RigidTransform())
    declare_output(system, "object_velocity", velocity, inputs, model=SpatialVelocity.Zero())


def declare_cache(
    system: LeafSystem, name: str, calc: Calc, prerequisites: Collection[Source]
) -> Cached:
    """A cache entry with the Python object that ``calc`` returns."""
    producer = ValueProducer(to_value(None).Clone, _kept_by(system, _setting(calc)))
    return Cached(system, system.DeclareCacheEntry(name, producer, _tickets(prerequisites)))


class Cached:
    """A cache entry of a system, which it does not keep alive as Drake's own handle does."""

    def __init__(self, system: LeafSystem, entry: CacheEntry) -> None:
        self._system, self._index = weakref.ref(system), entry.cache_index()
        self._ticket = entry.ticket()

    def Eval(self, context: Context) -> Any:
        """The value."""
        system = self._system()
        assert system is not None  # whose context could this be?
        return system.get_cache_entry(self._index).Eval(context)

    def ticket(self) -> DependencyTicket:
        """Dependency ticket."""
        return self._ticket


class ObjectState:
    """A Python object that is state of a system.

    It is read as ports are, by ``Eval``, and a prerequisite of others as they are.
    """

    def __init__(self, system: LeafSystem, initial: Any) -> None:
        index = system.DeclareAbstractState(to_value(initial))
        self._index, self._ticket = int(index), system.abstract_state_ticket(index)

    def every(self, system: LeafSystem, period: float, offset: float, update: Calc) -> None:
        """Updates it every ``period`` seconds from ``offset`` on to what ``update`` returns."""

        def advance(context: Context, state: State) -> None:
            self.set(state, update(context))

        system.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, _kept_by(system, advance))

    def set(self, to: State | Context, value: Any) -> None:
        """Sets the object in a state or a context."""
        to.get_mutable_abstract_state(self._index).set_value(_stored(value))

    def Eval(self, context: Context) -> Any:
        """The object at present."""
        return _read(context.get_abstract_state(self._index).get_value())

    def ticket(self) -> DependencyTicket:
        """Dependency ticket."""
        return self._ticket


class PeriodicState(ObjectState):
    """An `ObjectState` that is every ``period`` seconds what ``update`` returns from then on."""

    def __init__(self, system: LeafSystem, initial: Any, period: float, update: Calc) -> None:
        super().__init__(system, initial)
        self.every(system, period, 0.0, update)


def add_connected(
    builder: DiagramBuilder, name: str, system: _System, *first: OutputPort, **named: OutputPort
) -> _System:
    """Adds a system to a diagram, with sources of its ``first`` inputs, and of others by name."""
    builder.AddNamedSystem(name, system)
    for index, source in enumerate(first):
        builder.Connect(source, system.get_input_port(index))
    for port, source in named.items():
        builder.Connect(source, system.GetInputPort(port))
    return system


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """A method of a system, for Drake to call without keeping the system alive.

    Drake 1.51 holds callbacks out of sight of Python's garbage collector (1.58 some of them), so
    that a system whose callbacks are its own methods is never freed: 40 MB for each diagram.
    """
    return _kept_by(method.__self__, method)  # type: ignore[attr-defined]


def _kept_by(system: LeafSystem, call: Callable[..., Any]) -> Callable[..., Any]:
    """Calls ``call``, which the system itself keeps."""
    calls = system.__dict__.setdefault("_callbacks", [])
    calls.append(call)
    number, owner = len(calls) - 1, weakref.ref(system)
    return lambda *given: owner()._callbacks[number](*given)  # type: ignore[union-attr]


def _setting(calc: Calc) -> Callable[[Context, AbstractValue], None]:
    return lambda context, value: value.set_value(_stored(calc(context)))


def _tickets(sources: Collection[Source]) -> set[DependencyTicket]:
    return {s if isinstance(s, DependencyTicket) else s.ticket() for s in sources}


def _stored(value: Any) -> Any:
    return Nothing.NOTHING if value is None else value


def _read(value: Any) -> Any:
    return None if value is Nothing.NOTHING else value


class ArmPorts(Diagram):
    """A station whose ports ``arm.*`` are found as ``iiwa.*``, too."""

    def GetInputPort(self, port_name: str) -> InputPort:  # noqa: N802 - Drake's name
        """The input port of a name."""
        return super().GetInputPort(_present(port_name))

    def GetOutputPort(self, port_name: str) -> OutputPort:  # noqa: N802 - Drake's name
        """The output port of a name."""
        return super().GetOutputPort(_present(port_name))


def _present(name: str) -> str:
    if not name.startswith("iiwa."):
        return name
    present = name.replace("iiwa.", "arm.", 1)
    warnings.warn(f"port {name} is now {present}; rename it", FutureWarning, stacklevel=3)
    return present
