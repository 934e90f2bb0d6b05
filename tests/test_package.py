"""The shape of the package: what may import what, and what every module must say of itself."""

import ast
import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest

import feasigrasp

PACKAGE = Path(feasigrasp.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

#: Folder of the package -> prefixes that nothing inside may import. diagrams -> evaluation ->
#: systems -> models: each may use what stands after it, never before.
FORBIDDEN = {
    "models": (
        "pydrake",
        "feasigrasp.systems",
        "feasigrasp.evaluation",
        "feasigrasp.scenario.schema",
    ),
    "systems": ("feasigrasp.evaluation",),
    "evaluation": ("feasigrasp.cli",),
}


def module_name(path: Path) -> str:
    return str(path.relative_to(PACKAGE.parent).with_suffix("")).replace("/", ".")


def imported_names(path: Path) -> set[str]:
    """Dotted names of everything a module imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import; use absolute ones"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_dependencies_point_one_way(path):
    layer = path.relative_to(PACKAGE).parts[0]
    forbidden = (*FORBIDDEN.get(layer, ()), "diagrams", "pydrake.all")
    wrong = [
        name
        for name in imported_names(path)
        if any(name == prefix or name.startswith(f"{prefix}.") for prefix in forbidden)
    ]
    assert not wrong, f"{module_name(path)} imports {wrong}"


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_every_module_says_what_it_is_for(path):
    assert ast.get_docstring(ast.parse(path.read_text())), f"{path} has no docstring"


def test_the_one_way_rule_can_fail(tmp_path):
    """The checker itself sees imports at any depth and in both spellings."""
    source = tmp_path / "bad.py"
    source.write_text("import numpy\ndef f():\n    from pydrake.math import RigidTransform\n")
    assert imported_names(source) == {"numpy", "pydrake.math.RigidTransform"}


def test_version_is_the_same_everywhere(repository):
    version = feasigrasp.__version__
    assert importlib.metadata.version("feasigrasp") == version
    citation = (repository / "CITATION.cff").read_text()
    assert f"\nversion: {version}\n" in citation
    assert f"<version>{version}</version>" in (repository / "models" / "package.xml").read_text()


def test_every_import_is_a_declared_dependency(repository):
    """What package and diagrams import is installed with them, not by luck through others."""
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    # What makes training data may need more; it says what to install.
    entries = [*project["dependencies"], *project["optional-dependencies"]["train"]]
    declared = {re.split(r"[<>=\[ ]", entry)[0] for entry in entries}
    module_of = {"drake": "pydrake", "pyyaml": "yaml"}
    allowed = {module_of.get(name, name) for name in declared} | {"feasigrasp"}
    allowed |= set(sys.stdlib_module_names)
    sources = [*MODULES, *(repository / "diagrams").glob("*.py")]
    used = {name.split(".")[0] for path in sources for name in imported_names(path)}
    assert used <= allowed, f"not declared in pyproject.toml: {sorted(used - allowed)}"
