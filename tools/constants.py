"""The numeric constants of the packages with what their comments say: unit, meaning, source."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
#: What a source begins with, and what that means.
SOURCES = {
    "data sheet": "of the device that is named",
    "definition": "of a metric, protocol, format or quantity",
    "fitted": "by the command that is named",
    "formula": "the value, or the comment, has it",
    "guessed": "no record of another source; results depend on it as far as they were measured",
    "layout": "of an array, a network, a list of kinds, or a picture",
    "measured": "the comment has the figure",
    "numerical": "rounding, convergence, or size of a block; results hardly depend on it",
    "paper": "of the paper that is named, or of the one that is implemented",
    "reasoned": "the comment has the reason",
}


class Constant(NamedTuple):
    """A constant of a module.

    Attributes:
        module: Dotted name of the module.
        name: Its name.
        value: Its value, as the source has it.
        comment: The comment above it, with units in brackets; empty without one.
        source: How it was chosen, which begins with a word of `SOURCES`; empty if not said.
    """

    module: str
    name: str
    value: str
    comment: str
    source: str


def constants(package: str = "feasigrasp") -> Iterator[Constant]:
    """All numbers, and tuples of numbers, that modules of a package assign to upper-case names."""
    for file in sorted((ROOT / package).rglob("*.py")):
        text = file.read_text()
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for node in ast.parse(text).body:
            if isinstance(node, ast.Assign):
                comment = comment_above(text.splitlines(), node.lineno - 1)
                meaning, _, source = comment.partition("Source: ")
                for name, value in assigned(node):
                    if name.isupper():
                        yield Constant(
                            module, name, ast.unparse(value), meaning.strip(), source.rstrip(". ")
                        )


def assigned(node: ast.Assign) -> Iterator[tuple[str, ast.expr]]:
    """Names and numeric values of one assignment, taken apart where both are tuples."""
    target, value = node.targets[0], node.value
    pairs = [(target, value)]
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        pairs = list(zip(target.elts, value.elts, strict=True))
    for each, number in pairs:
        if isinstance(each, ast.Name) and is_numeric(number):
            yield each.id, number


def is_numeric(node: ast.expr) -> bool:
    """Whether an expression is made of numbers, and has one."""
    leaves = [n for n in ast.walk(node) if isinstance(n, ast.Constant)]
    plain = all(type(leaf.value) in (int, float) for leaf in leaves)
    return bool(leaves) and plain and not any(isinstance(n, ast.Dict) for n in ast.walk(node))


def comment_above(lines: list[str], first: int) -> str:
    """The comment behind a line and above it, or above constants that stand right above it."""
    behind = re.search(r"  # (.*)", lines[first])
    end = first
    while end and re.match(r"[A-Z_][A-Z0-9_, ]* = |[ )]", lines[end - 1]):
        end -= 1
    start = end
    while start and lines[start - 1].startswith("#"):
        start -= 1
    words = [line.lstrip("#: ") for line in lines[start:end]]
    return " ".join([*words, *([behind[1]] if behind else [])])
