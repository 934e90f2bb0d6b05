"""What the documentation names does exist: files, modules, definitions, commands, options."""

import re
from pathlib import Path

import pytest

from feasigrasp import cli

REPOSITORY = Path(__file__).parents[1]
PACKAGE = REPOSITORY / "feasigrasp"
LAB = REPOSITORY / "feasigrasp_lab"
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
PAGES += sorted(PACKAGE.rglob("*.md"))
MODULES = sorted([*PACKAGE.rglob("*.py"), *LAB.rglob("*.py")])
#: Where a path in a page may start.
ROOTS = (REPOSITORY, PACKAGE, PACKAGE / "models", LAB)
#: Folders of which paths are checked.
FOLDERS = (
    "feasigrasp|feasigrasp_lab|models|systems|scenario|training|runs|diagrams|examples|tests|docs"
)
#: Words of others, and mathematics: what may stand in backticks without being ours.
FOREIGN = {"PIP_EXTRA_INDEX_URL", "potrf", "drake_models", "manifold3d"}
#: Rows of summaries whose names are put together from parts.
PUT_TOGETHER = re.compile(r"^(bench|sampler|labels)\.|_(us|ms|percent)$")


def sources() -> str:
    """Everything in which a name may be defined."""
    folders = ("feasigrasp", "feasigrasp_lab", "diagrams", "examples", "models", "tools")
    files = [p for f in folders for p in (REPOSITORY / f).rglob("*") if p.suffix in SOURCE]
    names = " ".join(p.name for p in (REPOSITORY / "models").rglob("*"))
    return " ".join([names, *(p.read_text() for p in files), *(p.stem for p in files)])


SOURCE = {".py", ".yaml", ".json", ".urdf", ".sh", ".html"}


@pytest.fixture(scope="module")
def known() -> str:
    return sources()


def dotted_names(text: str) -> set[str]:
    return set(re.findall(r'(?<!")\bfeasigrasp(?:_lab)?(?:\.[A-Za-z_]\w*)+', text))


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or something that a module defines or hands on."""
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        path = REPOSITORY.joinpath(*parts[:n])
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if file.is_file():
            words = set(re.findall(r"\w+", file.read_text()))
            return all(part in words for part in parts[n:])
    return False


def missing_paths(text: str) -> set[str]:
    paths = re.findall(
        rf"(?<![\w/.:-])((?:{FOLDERS})/[\w./-]*\w\.(?:py|npz|md|yaml|json|html|png))", text
    )
    return {p for p in paths if not any((root / p).exists() for root in ROOTS)}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_paths_exist(page):
    text = page.read_text()
    links = re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text)
    assert not [link for link in links if not (page.parent / link).exists()]
    assert not missing_paths(text)


@pytest.mark.parametrize("page", [*PAGES, *MODULES], ids=lambda p: str(p.relative_to(REPOSITORY)))
def test_dotted_names_exist(page):
    assert not [name for name in dotted_names(page.read_text()) if not resolves(name)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_words_in_backticks_are_in_the_code(page, known):
    """Identifiers of two words or more, and classes: what was renamed is found here."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    words = {w for w in re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", text) if is_identifier(w)}
    unknown = {w for w in words - FOREIGN if any(part not in known for part in w.split("."))}
    assert not {w for w in unknown if not PUT_TOGETHER.search(w)}


def is_identifier(word: str) -> bool:
    return "feasigrasp." not in word and bool(re.search(r"[a-z]{2,}_[a-z]{2,}|[a-z][A-Z]", word))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_exist(page):
    commands = cli.installed_commands().groups
    text, groups = page.read_text(), "|".join(commands)
    named = re.findall(rf"feasigrasp ({groups}) ([a-z][\w-]*)", text)
    assert not [(group, name) for group, name in named if name not in commands[group][1]]
    first = set(re.findall(r"`(?:\.venv/bin/)?feasigrasp ([a-z][\w-]*)", text))
    for block in re.findall(r"^```\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        first |= set(re.findall(r"^feasigrasp ([a-z][\w-]*)", block, re.MULTILINE))
    assert not first - {*cli.installed_commands().groups, *cli.installed_commands().single}


def test_the_checks_can_fail():
    assert missing_paths("see `models/shape/nowhere.py`") == {"models/shape/nowhere.py"}
    assert not missing_paths("see `models/geometry/se3.py` and `docs/method.md`")
    assert not resolves("feasigrasp.models.nowhere.Thing")
    assert not resolves("feasigrasp.models.geometry.se3.nothing_of_that_name")
    assert resolves("feasigrasp.models.geometry.se3.log")
