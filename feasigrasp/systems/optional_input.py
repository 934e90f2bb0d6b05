"""Input ports that may be left unconnected, or carry None."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import CacheEntry, Context, InputPort, LeafSystem, ValueProducer


def eval_optional(port: InputPort, context: Context) -> Any:
    """The value of an input port; None if nothing is connected to it."""
    return port.Eval(context) if port.HasValue(context) else None


def declare_derived(
    system: LeafSystem, name: str, port: InputPort, derive: Callable[[Any], Any]
) -> CacheEntry:
    """Declares a cache entry with what follows from an optional input.

    Args:
        system: Owner of the port.
        name: Describes the entry.
        port: One of its abstract input ports.
        derive: Applied to the port's value when that has changed; None stays None.
    """

    def calc(context: Context, value: AbstractValue) -> None:
        given = eval_optional(port, context)
        value.set_value(None if given is None else derive(given))

    producer = ValueProducer(allocate=lambda: Value[object](None), calc=calc)
    return system.DeclareCacheEntry(name, producer, prerequisites_of_calc={port.ticket()})
