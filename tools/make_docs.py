"""Writes the pages of ``docs/`` that say what is in the code: ``api.md`` and ``examples.md``.

Run ``python tools/make_docs.py`` after a change of a public name or an example; a test compares the
pages with the code. With ``--pictures`` the examples are run, and their pictures drawn anew.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "images" / "examples"
API_HEAD = """# Public names

What the packages hand on; everything else may change without notice. Shapes, units, frames and
errors are in the docstrings. `python tools/make_docs.py` writes this page.
"""
EXAMPLES_HEAD = """# Examples

Each runs by itself (`python examples/01_complete_a_cloud.py`), prints what it found and draws a
picture, into `out/examples` or where an argument says; a test runs them all.
`python tools/make_docs.py --pictures` writes this page and its pictures.
"""


def faces() -> list[str]:
    """Packages with public names, models first, in alphabetical order."""
    found = []
    for file in (ROOT / "feasigrasp").rglob("__init__.py"):
        names = {
            target.id
            for node in ast.parse(file.read_text()).body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        if "__all__" in names:
            found.append(".".join(file.parent.relative_to(ROOT).parts))
    return sorted(found)


def summary(thing: object) -> str:
    """The first sentence of a docstring, on one line."""
    text = (getattr(thing, "__doc__", None) or "").split("\n\n")[0]
    return " ".join(text.split())


def api_page() -> str:
    """The public names, package by package."""
    parts = [API_HEAD]
    for face in faces():
        module = import_module(face)
        parts.append(f"## `{face}`\n\n{summary(module)}\n\n| name | what it is |\n|---|---|")
        for name in module.__all__:
            thing = getattr(module, name)
            module_too = " (a module)" if isinstance(thing, ModuleType) else ""
            parts[-1] += f"\n| `{name}`{module_too} | {summary(thing)} |"
        parts[-1] += "\n"
    return "\n".join(parts)


def examples() -> list[Path]:
    """The numbered scripts."""
    return sorted((ROOT / "examples").glob("[0-9]*.py"))


def examples_page() -> str:
    """Every example with its picture."""
    parts = [EXAMPLES_HEAD]
    for script in examples():
        code = script.read_text()
        title = (ast.get_docstring(ast.parse(code)) or "").splitlines()[0]
        number = script.stem.split("_")[0].lstrip("0")
        picture = f"images/examples/{script.stem}.png"
        parts.append(
            f"## {number}. {title}\n\n`examples/{script.name}`\n\n![{title}]({picture})\n\n"
            f"```python\n{code}```\n"
        )
    return "\n".join(parts)


def draw_pictures() -> None:
    """Runs the examples."""
    for script in examples():
        picture = PICTURES / f"{script.stem}.png"
        subprocess.run([sys.executable, str(script), str(picture)], check=True, cwd=ROOT)


def main() -> int:
    """Writes the pages."""
    if "--pictures" in sys.argv[1:]:
        draw_pictures()
    (ROOT / "docs" / "api.md").write_text(api_page())
    (ROOT / "docs" / "examples.md").write_text(examples_page())
    return 0


if __name__ == "__main__":
    sys.exit(main())
