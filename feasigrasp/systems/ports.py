"""Ports, caches and states of abstract values: their functions return what they compute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    CacheEntry,
    Context,
    DependencyTicket,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
    ValueProducer,
)

Calc = Callable[[Context], Any]


def declare_input(system: LeafSystem, name: str, model: Any = None) -> InputPort:
    """An input port for values of the type of ``model``; None for any Python object."""
    return system.DeclareAbstractInputPort(name, AbstractValue.Make(model))


def optional(port: InputPort, context: Context) -> Any:
    """The value of an input port; None if nothing is connected to it."""
    return port.Eval(context) if port.HasValue(context) else None


def declare_output(
    system: LeafSystem,
    name: str,
    calc: Calc,
    prerequisites: set[DependencyTicket] | None = None,
    *,
    model: Any = None,
) -> OutputPort:
    """An output port whose value ``calc`` returns, of the type of ``model`` (see `declare_input`).

    Without ``prerequisites`` it depends on everything.
    """
    allocate = AbstractValue.Make(model).Clone
    tickets = prerequisites or {system.all_sources_ticket()}
    return system.DeclareAbstractOutputPort(name, allocate, _setting(calc), tickets)


def declare_cache(
    system: LeafSystem, name: str, calc: Calc, prerequisites: set[DependencyTicket]
) -> CacheEntry:
    """A cache entry with the Python object that ``calc`` returns."""
    producer = ValueProducer(AbstractValue.Make(None).Clone, _setting(calc))
    return system.DeclareCacheEntry(name, producer, prerequisites)


class PeriodicState:
    """A Python object that is state of a system, made anew every ``period`` seconds.

    It is read as ports are, by ``Eval``, and is a prerequisite of others by its ``ticket``.
    """

    def __init__(self, system: LeafSystem, initial: Any, period: float, update: Calc) -> None:
        """Declares the state; ``update`` returns what it is from then on."""
        index = system.DeclareAbstractState(AbstractValue.Make(initial))
        self._index, self._ticket = int(index), system.abstract_state_ticket(index)

        def advance(context: Context, state: State) -> None:
            state.get_mutable_abstract_state(self._index).set_value(update(context))

        system.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, advance)

    def Eval(self, context: Context) -> Any:
        """The object at present."""
        return context.get_abstract_state(self._index).get_value()

    def ticket(self) -> DependencyTicket:
        """Says that something depends on it."""
        return self._ticket


def _setting(calc: Calc) -> Callable[[Context, AbstractValue], None]:
    return lambda context, value: value.set_value(calc(context))
