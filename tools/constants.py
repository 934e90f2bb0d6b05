"""The numeric constants of the package with what their comments say: unit, meaning, source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Constant(NamedTuple):
    """A constant of a module.

    Attributes:
        module: Dotted name of the module.
        name: Its name.
        value: Its value, as the source has it.
        comment: The comment above it; empty without one.
    """

    module: str
    name: str
    value: str
    comment: str


def constants(package: str = "feasigrasp") -> Iterator[Constant]:
    """All numbers, and tuples of numbers, that modules of a package assign to upper-case names."""
    for file in sorted((ROOT / package).rglob("*.py")):
        source = file.read_text()
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for node in ast.parse(source).body:
            if isinstance(node, ast.Assign):
                comment = comment_above(source.splitlines(), node.lineno - 1)
                for name, value in assigned(node):
                    yield Constant(module, name, ast.unparse(value), comment)


def assigned(node: ast.Assign) -> Iterator[tuple[str, ast.expr]]:
    """Names and values of one assignment, taken apart where both are tuples."""
    target, value = node.targets[0], node.value
    pairs = [(target, value)]
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        pairs = list(zip(target.elts, value.elts, strict=True))
    for each, number in pairs:
        if isinstance(each, ast.Name) and each.id.isupper() and is_numeric(number):
            yield each.id, number


def is_numeric(node: ast.expr) -> bool:
    """Whether an expression is made of numbers, and has one."""
    leaves = [n for n in ast.walk(node) if isinstance(n, ast.Constant)]
    plain = all(type(leaf.value) in (int, float) for leaf in leaves)
    return bool(leaves) and plain and not any(isinstance(n, ast.Dict) for n in ast.walk(node))


def comment_above(lines: list[str], first: int) -> str:
    """The comment that ends above a line, and what stands behind that line, as one text."""
    start = first
    while start and lines[start - 1].startswith("#"):
        start -= 1
    words = [line.lstrip("#: ") for line in lines[start:first]]
    behind = re.search(r"  # (.*)", lines[first])
    return " ".join([*words, *([behind[1]] if behind else [])])
