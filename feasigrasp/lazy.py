"""Faces of packages whose modules are loaded only when something of them is asked for."""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # importing typing would take longer than all the rest of a face
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any


def hand_on(
    package: str, modules: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Module-level ``__getattr__`` and ``__dir__`` (PEP 562) of a package with lazy public names.

    A notebook completes by ``__dir__``: the package's ``__all__``, of which nothing is loaded.

    Args:
        package: ``__name__`` of the package.
        modules: By public name, the module of the package that defines it.
    """

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    def names() -> list[str]:
        public: list[str] = sys.modules[package].__all__
        return sorted(public)

    return load, names
