"""Faces of packages whose modules are loaded only when something of them is asked for."""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # importing typing would take longer than all the rest of a face
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any


def hand_on(package: str, modules: Mapping[str, str]) -> Callable[[str], Any]:
    """A module-level ``__getattr__`` (PEP 562) that imports what a package hands on.

    Args:
        package: ``__name__`` of the package.
        modules: By public name, the module of the package that defines it.
    """

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    return load
