"""Input ports that may be left unconnected, or carry None."""

from typing import Any

from pydrake.systems.framework import Context, InputPort


def eval_optional(port: InputPort, context: Context) -> Any:
    """The value of an input port; None if nothing is connected to it."""
    return port.Eval(context) if port.HasValue(context) else None
