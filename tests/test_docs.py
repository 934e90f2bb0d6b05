"""What the documentation names exists: links, files, names, commands; its size and its words."""

import json
import re
from pathlib import Path

import pytest

from feasigrasp import cli
from tools.make_docs import SCHEMA, page
from tools.run_schema import run_schema

REPOSITORY = Path(__file__).parents[1]
DOCS = sorted((REPOSITORY / "docs").glob("*.md"))
CARDS = sorted(REPOSITORY.glob("feasigrasp*/**/weights/*.md"))
PAGES = [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md", *DOCS, *CARDS]
CODE = [
    file
    for folder in ("feasigrasp", "feasigrasp_lab", "diagrams", "examples", "tools", "tests")
    for file in sorted((REPOSITORY / folder).rglob("*"))
    if file.suffix in {".py", ".yaml", ".json", ".sh", ".html"}
]
#: Largest size of a page [bytes], and which may be larger; ``make lint`` holds the sum to a table.
LARGEST, LARGE = 14 * 1024, {"method.md", "api.md"}
#: Words that the glossary replaces, and objects that are no persons.
OLD_WORDS = re.compile(
    r"\b(strands?|outlook|lookout|funnel|astray|anyhow|unsure|second look|rehears\w+|likelier|surer"
    r"|who is who|how surely|(?:robot )?twins?|befalls?|blows|struck|told|tells|heard|hears|knows"
    r"|believed|believes|nobody|(?:nothing|what) (?:was|is) seen|by now|so far|used to)\b",
    re.IGNORECASE,
)
#: Words of others, and mathematics, that may stand in backticks.
FOREIGN = {"PIP_EXTRA_INDEX_URL", "potrf", "drake_models", "pyrealsense2", "my_grasps.py"}
#: Rows of summaries whose names are put together from parts.
PUT_TOGETHER = re.compile(r"^(bench|sampler|labels)\.|_(us|ms|percent)$")


def anchors(text: str) -> set[str]:
    """What a link may have behind ``#``."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in headings}


def broken_links(file: Path, text: str) -> list[str]:
    """Links of a page to files or headings that are not there."""
    broken = []
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        name, _, anchor = target.partition("#")
        there = file.parent / name if name else file
        if not there.exists() or (anchor and anchor not in anchors(there.read_text())):
            broken.append(f"{file.name}: {target}")
    return broken


def prose(text: str) -> str:
    """A page without code and link targets."""
    text = re.sub(r"```.*?```|``.*?``|`[^`\n]*`", "", text, flags=re.DOTALL)
    return re.sub(r"\]\([^)]*\)", "]", text)


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


def unresolved(text: str) -> set[str]:
    """Dotted names of the packages that are not there."""
    names = re.findall(r'(?<!")\bfeasigrasp(?:_lab)?(?:\.[A-Za-z_]\w*)+', text)
    return {name for name in names if "__" not in name and not resolves(name)}


def missing_paths(text: str) -> set[str]:
    """Paths from the root of the repository that are not there."""
    paths = re.findall(
        r"(?<![\w/.:-])((?:feasigrasp|feasigrasp_lab|diagrams|examples|tests|tools|docs)/[\w./-]*\w"
        r"\.(?:py|npz|md|yaml|json|html|png|sh))\b",
        text,
    )
    return {path for path in paths if not (REPOSITORY / path).exists()}


def test_every_link_and_path_of_the_pages_leads_somewhere():
    linked = [*PAGES, REPOSITORY / "CHANGELOG.md"]
    assert not [link for file in linked for link in broken_links(file, file.read_text())]
    missing = {file.name: missing_paths(file.read_text()) for file in PAGES}
    assert not {name: paths for name, paths in missing.items() if paths}


def test_every_page_that_the_code_names_is_there():
    """Also with its heading: ``docs/hardware.md#speed``."""
    for file in set(CODE) - {Path(__file__)}:
        for name, anchor in re.findall(r"\bdocs/(\w+\.md)(?:#([\w-]+))?", file.read_text()):
            there = REPOSITORY / "docs" / name
            assert there.exists(), f"{file}: {name}"
            assert not anchor or anchor in anchors(there.read_text()), f"{file}: {name}#{anchor}"


def test_every_name_in_the_pages_is_in_the_code():
    """Dotted names, and identifiers of two words or more: what was renamed is found here."""
    known = " ".join(file.read_text() for file in CODE)
    known += " ".join(path.name for path in [*CODE, *(REPOSITORY / "models").rglob("*")])
    for file in PAGES:
        text = file.read_text()
        assert not unresolved(text), file.name
        words = re.findall(
            r"`([A-Za-z_][\w.]*)(?:\(\))?`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)
        )
        two = {w for w in words if re.search(r"[a-z]{2,}_[a-z]{2,}|[a-z][A-Z]", w)} - FOREIGN
        unknown = {w for w in two if any(part not in known for part in w.split("."))}
        assert not {w for w in unknown if not PUT_TOGETHER.search(w)}, file.name
    for file in CODE:
        assert file.suffix != ".py" or not unresolved(file.read_text()), file


def test_every_command_that_the_pages_name_is_there():
    commands = cli.installed_commands()
    groups, singles = "|".join(commands.groups), {*commands.groups, *commands.single}
    for file in PAGES:
        text = file.read_text()
        for group, name in re.findall(rf"\bfeasigrasp ({groups}) ([a-z][\w-]*)", text):
            assert name in commands.groups[group][1], f"{file.name}: {group} {name}"
        found = set(re.findall(r"`feasigrasp ([a-z][\w-]*)", text))
        assert not found - singles, file.name


def test_no_page_is_long():
    size = {file.name: file.stat().st_size for file in DOCS if file.name not in LARGE}
    assert not {name: length for name, length in size.items() if length > LARGEST}


def test_the_pages_use_the_words_of_the_glossary():
    """Of the reference only what is no docstring."""
    for file in DOCS:
        if file.name != "api.md":
            found = [match[0] for match in OLD_WORDS.finditer(prose(file.read_text()))]
            assert not found, file.name


#: Around tables of measured figures.
MARKS = r"<!-- (?:table: \w+|end) -->"


def test_the_pages_have_no_comments():
    """But those around tables of measured figures."""
    assert not [f.name for f in DOCS if "<!--" in re.sub(MARKS, "", f.read_text())]


def test_the_reference_is_that_of_the_code():
    stale = "stale: run python tools/make_docs.py"
    assert (REPOSITORY / "docs" / "api.md").read_text() == page(), stale
    assert json.loads(SCHEMA.read_text()) == run_schema(), stale


@pytest.mark.parametrize(
    ("find", "text"),
    [
        (missing_paths, "see `docs/nowhere.py`"),
        (unresolved, "feasigrasp.models.nowhere.Thing"),
        (unresolved, "feasigrasp.models.geometry.se3.nothing_of_that_name"),
        (lambda text: OLD_WORDS.findall(prose(text)), "the filter knows, and `twins` are strands"),
        (lambda text: broken_links(PAGES[0], text), "[a](docs/concepts.md#nowhere)"),
        (lambda text: broken_links(PAGES[0], text), "[a](docs/nowhere.md)"),
    ],
)
def test_the_checks_can_fail(find, text):
    assert find(text)
    fine = "`docs/method.md`, [b](docs/method.md#grasps), feasigrasp.models.geometry.se3.log"
    assert not find(fine)
