"""The shape of the package: what may import what, and what every module must say of itself."""

import ast
import graphlib
import importlib.metadata
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import feasigrasp

PACKAGE = Path(feasigrasp.__file__).parent
LAB = PACKAGE.with_name("feasigrasp_lab")
MODULES = sorted([*PACKAGE.rglob("*.py"), *LAB.rglob("*.py")])

#: The order of imports: a package may import from its own row's packages' predecessors only, that
#: is, from what stands in a row above, and within itself. Subpackages not listed belong to the
#: package that they lie in.
ORDER = (
    ("errors", "models.arrays"),
    ("plugins",),
    ("resources", "inputs", "outputs"),
    (
        "models.choices",
        "models.weights_file",
        "models.quantities",
    ),
    ("models.arguments",),
    ("models.numerics",),
    ("models.geometry",),
    ("models.robot", "models.objects", "models.clouds"),
    ("models.faults", "models.sensors"),
    ("models.ik", "models.shape", "models.segmentation"),
    ("models.tracking",),
    ("models.grasps.network",),
    ("models.grasps",),
    ("models.reach",),
    ("models.control.safety",),
    ("models.control.planning",),
    ("models.control.horizon",),
    ("recordings", "scenario"),
    ("systems.ports",),
    ("systems.station", "systems.remote"),
    ("systems",),
    ("systems.hardware",),
    ("runs.results",),
    ("runs.metrics",),
    ("runs",),
    ("runs.hardware", "runs.pictures"),
    ("warm_up",),
    ("commands",),
    ("cli",),
    ("lab.networks", "lab.arm", "lab.mixtures"),
    ("lab.paper",),
    ("lab.results", "lab.baselines"),
    ("lab.training.data",),
    ("lab.training",),
    ("lab.protocols",),
    ("lab.peers", "lab.runs"),
    ("lab.report", "lab.tracking"),
    ("lab.bench", "lab.studies"),
    ("lab.commands",),
)
ROW = {package: row for row, packages in enumerate(ORDER) for package in packages}

#: What the numerics never load.
FORBIDDEN = {"models": ("pydrake",)}


def package_of(name: str) -> str | None:
    """The entry of `ORDER` that a dotted name belongs to; None for other people's packages."""
    parts = name.removeprefix("feasigrasp").lstrip("._").split(".")
    found = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
    return next((p for p in found if p in ROW), None) if name.startswith("feasigrasp") else None


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


def upward_imports(module: str, names: set[str]) -> list[str]:
    """What a module must not import: packages that do not stand above its own in `ORDER`."""
    own = package_of(module)
    layer = module.split(".")[1] if "." in module else ""
    forbidden = (*FORBIDDEN.get(layer, ()), "diagrams", "pydrake.all")
    wrong = [n for n in names if n.startswith(tuple(f"{p}." for p in forbidden)) or n in forbidden]
    if own is None:  # the faces of feasigrasp, models, training ... themselves
        return wrong
    others = {name: package_of(name) for name in names}
    return wrong + [n for n, p in others.items() if p not in (None, own) and ROW[p] >= ROW[own]]


def test_dependencies_point_one_way():
    names = {module_name(path): imported_names(path) for path in MODULES}
    wrong = {module: upward_imports(module, imported) for module, imported in names.items()}
    assert not {module: imported for module, imported in wrong.items() if imported}


def test_no_estimator_reads_the_errors_of_simulated_sensors():
    """Those are drawn by the cell that is simulated; estimators have constants of their own."""
    simulate = ("models.sensors", "scenario", "systems.station", "systems.from_scenario")
    allowed = (*(f"feasigrasp.{part}" for part in simulate), "feasigrasp_lab")
    readers = {
        module_name(path)
        for path in MODULES
        if any(name.startswith("feasigrasp.models.sensors") for name in imported_names(path))
    }
    assert not [module for module in readers if not module.startswith(allowed)]


def test_every_folder_has_its_place_in_the_order():
    folders = {module_name(path.parent) for path in MODULES if path.name != "__init__.py"}
    parents = {"feasigrasp", "feasigrasp.models", "feasigrasp.models.control", "feasigrasp_lab"}
    unknown = [f for f in folders - parents if package_of(f) is None]
    assert not unknown


def test_no_module_imports_itself_in_a_circle():
    names = {module_name(path).removesuffix(".__init__"): path for path in MODULES}
    graph = {
        name: {m for n in imported_names(path) for m in (n, n.rpartition(".")[0]) if m in names}
        for name, path in names.items()
        if path.name != "__init__.py"
    }
    list(graphlib.TopologicalSorter(graph).static_order())


def test_the_safety_filter_depends_on_few_files():
    """Who certifies the arm reads these: at most 20 files, and none about fields or grasps."""
    names = {module_name(path): path for path in MODULES if path.name != "__init__.py"}
    found, left = set(), [m for m in names if m.startswith("feasigrasp.models.control.safety")]
    while left:
        if (name := left.pop()) not in found:
            found.add(name)
            imported = imported_names(names[name])
            left += [m for n in imported for m in (n, n.rpartition(".")[0]) if m in names]
    assert len(found) <= 20, sorted(found)
    assert not [name for name in found if name.startswith("feasigrasp.models.shape")]


#: Definitions that nothing but a test names: a limit that a docstring states and a test tries, and
#: a former name.
NAMED_TRUTHS = {"MAX_EXPONENT", "Safety"}


def words_of_code(source: str) -> list[str]:
    """Every word of a module but those of docstrings, imports and ``__all__``."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [n for n in body if not is_no_use(n)] or [ast.Pass()]
    return re.findall(r"[A-Za-z_]\w*", ast.unparse(tree))


def is_no_use(node: ast.stmt) -> bool:
    if isinstance(node, ast.Assign):
        return any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
    text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return text or isinstance(node, (ast.Import, ast.ImportFrom))


def defined_names(body: list[ast.stmt]) -> Iterator[str]:
    """Functions, classes, constants and, inside classes, methods and fields; no enum members."""
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
            if isinstance(node, ast.ClassDef) and "StrEnum" not in map(ast.unparse, node.bases):
                yield from defined_names(node.body)
        elif isinstance(node, ast.Assign):
            yield from (t.id for t in node.targets if isinstance(t, ast.Name))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def test_nothing_is_there_for_tests_alone(repository):
    """Every definition is named once more in package, diagrams, examples, generators or tools.

    Counted by words: a name that something else has as well is not found.
    """
    folders = ("feasigrasp", "feasigrasp_lab", "diagrams", "examples", "models", "tools")
    sources = {p: p.read_text() for f in folders for p in (repository / f).rglob("*.py")}
    uses = Counter(word for text in sources.values() for word in words_of_code(text))
    entry_points = (repository / "pyproject.toml").read_text()
    uses.update(re.findall(r":(\w+)\"", entry_points))
    alone = [
        f"{module_name(path)}.{name}"
        for path in MODULES
        for name in defined_names(ast.parse(sources[path]).body)
        if uses[name] < 2 and not name.startswith("__") and name not in NAMED_TRUTHS
    ]
    assert not alone


def test_the_models_are_few_packages():
    """At most 15 packages in `models`, and at most 43 arrows between them, in no circle."""
    arrows = {
        (own, other)
        for path in MODULES
        for name in imported_names(path)
        if (own := room(module_name(path))) and (other := room(name)) and own != other
    }
    rooms = {room for arrow in arrows for room in arrow}
    assert len(rooms) <= 15
    assert len(arrows) <= 43
    graph = {room: {b for a, b in arrows if a == room} for room in rooms}
    list(graphlib.TopologicalSorter(graph).static_order())


def room(name: str) -> str | None:
    """The package of `models` that a dotted name is in."""
    parts = name.split(".")
    inside = parts[:2] == ["feasigrasp", "models"] and len(parts) > 3
    return parts[2] if inside and (PACKAGE / "models" / parts[2]).is_dir() else None


def test_folders_are_small():
    counts = Counter(path.parent for path in MODULES)
    assert not [f"{module_name(f)}: {n} files" for f, n in counts.items() if n > 18]


def test_every_module_says_what_it_is_for():
    assert not [path for path in MODULES if not ast.get_docstring(ast.parse(path.read_text()))]


def is_compiled(function: ast.FunctionDef) -> bool:
    decorators = map(ast.unparse, function.decorator_list)
    return any("compiled" in d or "intrinsic" in d for d in decorators)


def untyped_functions(source: str) -> list[str]:
    """Functions with a parameter or a result that has no type; compiled ones need none."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and not is_compiled(node):
            of_method = node.args.args and node.args.args[0].arg in ("self", "cls")
            parameters = [*node.args.args[1 if of_method else 0 :], *node.args.kwonlyargs]
            if node.returns is None or any(p.annotation is None for p in parameters):
                found.append(f"{node.name}, line {node.lineno}")
    return found


def test_the_mathematics_is_typed():
    """Mypy lets functions without types pass, for the sake of compiled ones; others have some."""
    found = {
        path: untyped_functions(path.read_text()) for path in (PACKAGE / "models").rglob("*.py")
    }
    assert not {path: functions for path, functions in found.items() if functions}


def test_an_untyped_function_is_found():
    assert untyped_functions("def f(x, y: int) -> int: ...") == ["f, line 1"]
    assert untyped_functions("@compiled(nogil=True)\ndef f(x): ...") == []


def test_an_upward_import_is_found():
    assert upward_imports("feasigrasp.models.geometry.se3", {"feasigrasp.models.ik.self_motion.X"})
    assert upward_imports("feasigrasp.models.geometry.se3", {"pydrake.math.RigidTransform"})
    assert upward_imports("feasigrasp.models.robot.iiwa", {"feasigrasp.models.objects.mesh.Mesh"})
    assert not upward_imports("feasigrasp.models.ik.x", {"feasigrasp.models.robot.iiwa.X"})


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
    # What compares with peers may need more; it says what to install.
    extra = project["optional-dependencies"]
    optional = ("exr", "mcap", "peers", "realsense")
    entries = [*project["dependencies"], *(entry for name in optional for entry in extra[name])]
    declared = {re.split(r"[<>=\[ ]", entry)[0] for entry in entries}
    module_of = {"drake": "pydrake", "pillow": "PIL", "pyyaml": "yaml"}
    module_of |= {
        "small-gicp": "small_gicp",
        "mcap-ros2-support": "mcap_ros2",
        "lazy-loader": "lazy_loader",
    }
    allowed = {module_of.get(name, name) for name in declared} | {"feasigrasp", "feasigrasp_lab"}
    allowed |= {"drake"}  # the messages in the wheel of that name
    allowed |= set(sys.stdlib_module_names)
    sources = [*MODULES, *(repository / "diagrams").glob("*.py")]
    used = {name.split(".")[0] for path in sources for name in imported_names(path)}
    assert used <= allowed, f"not declared in pyproject.toml: {sorted(used - allowed)}"


def test_no_class_has_two_bases_that_are_systems():
    """Drake 1.58 refuses such a class when its module is imported."""
    classes = {
        node.name: {ast.unparse(base) for base in node.bases}
        for path in [*MODULES, *(PACKAGE.parent / "tests").rglob("*.py")]
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    }

    def is_system(name: str) -> bool:
        return name in ("LeafSystem", "Diagram") or any(map(is_system, classes.get(name, ())))

    assert is_system("PaperTaskController")
    assert not [name for name, bases in classes.items() if sum(map(is_system, bases)) > 1]
