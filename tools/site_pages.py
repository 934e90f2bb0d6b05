"""Pages of the documentation site that are made when it is built; a hook of MkDocs.

Docstrings, release notes and how to contribute come from the code and from files at the root, the
notebook from ``examples``; the report from the stored summaries, as `feasigrasp report --html`
makes it; the gallery of replays from ``out/gallery``, where `feasigrasp evaluate gallery` left it.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from importlib import import_module
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

from feasigrasp.outputs import write_json
from feasigrasp_lab.report.html_report import write_page
from feasigrasp_lab.report.markdown_report import sections
from tools.constants import SOURCES, constants
from tools.make_docs import ROOT, faces
from tools.stored import names, read

GALLERY = ROOT / "out" / "gallery"
_PICTURES = """# Gallery

`feasigrasp run ReachLinearBelt --seed 1 --replay replay.html`:

![The arm follows a bottle on a moving belt, grasps and lifts it](images/demo.webp)

`feasigrasp run ReachCircular --object mustard_bottle --seed 1 --ghost paper --replay replay.html`:

![In violet, where the printed law would have the arm](images/ghost.webp)

## Replays
"""
_NO_GALLERY = """

Replays of every scenario, controller and mode, to turn and to step through in the browser. This
site was built without them; `feasigrasp evaluate gallery` makes them, and the next `make docs`
takes them in.
"""
_WITH_GALLERY = """
[Replays of every scenario, controller and mode](replays/index.html), to turn and to step through in
the browser.
"""


_REPORT = """# Report

[All stored results of the static and the dynamic test on one page](all_results.html): tables beside
the paper's, curves, what became of every object, why runs did not hold, and the conditions of each.
It is what `feasigrasp report DIR --html` makes of a folder of results; where the runs are there as
well, with the worst failures and links to their replays.
"""


@event_priority(100)  # before the plugin that converts notebooks
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages."""
    pages = {
        "docstrings.md": _docstrings(),
        "constants.md": _constants(),
        "release_notes.md": _from_the_root("CHANGELOG.md"),
        "contributing.md": _from_the_root("CONTRIBUTING.md"),
        "report.md": _REPORT,
        "all_results.html": _report(),
        "gallery.md": _PICTURES + (_WITH_GALLERY if GALLERY.is_dir() else _NO_GALLERY),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    notebook = "perceive_a_cloud.ipynb", str(ROOT / "examples")
    files.append(File(*notebook, config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links out of ``docs`` lead nowhere on the site: their text is left."""
    return re.sub(r"\[([^\]]+)\]\(\.\./([\w./]+)\)", r"\1 (`\2`)", markdown)


def _report() -> str:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in names():
            if name.startswith(("static_", "dynamic_")):
                write_json(read(name).summary(), folder / name / "summary.json")
        return write_page(folder, sections(folder)).read_text()


def on_post_build(config: MkDocsConfig) -> None:
    """Puts the replays beside the pages."""
    if GALLERY.is_dir():
        shutil.copytree(GALLERY, Path(config.site_dir) / "replays", dirs_exist_ok=True)


def _docstrings() -> str:
    parts = ["# Docstrings\n\nOf the public names; [in short](api.md).\n"]
    for face in faces():
        names = _public_names(face)
        options = "".join(f"\n        - {name}" for name in names)
        parts.append(f"## `{face}`\n\n::: {face}\n    options:\n      members:{options}\n")
    return "\n".join(parts)


def _constants() -> str:
    rows = [
        f"| `{c.module}` | `{c.name}` | `{c.value}` | {escaped(c.comment)} | {escaped(c.source)} |"
        for package in ("feasigrasp", "feasigrasp_lab")
        for c in constants(package)
    ]
    sources = "".join(f"- {word}: {meaning}\n" for word, meaning in SOURCES.items())
    head = "| module | name | value | meaning, unit | source |\n|---|---|---|---|---|\n"
    text = "# Constants\n\nAll numeric constants of modules. Numbers without a unit are counts or "
    return f"{text}ratios. Sources:\n\n{sources}\n{head}" + "\n".join(rows)


def escaped(text: str) -> str:
    """A text as a cell of a table."""
    return text.replace("|", "\\|")


def _public_names(face: str) -> list[str]:
    """What ``__all__`` of a package lists."""
    return list(import_module(face).__all__)


def _from_the_root(name: str) -> str:
    """A file of the root, with its links to where the site has it; what it has not is no link."""
    text = (ROOT / name).read_text()
    text = re.sub(r"\]\(docs/", "](", text)
    return re.sub(r"\[([^\]]+)\]\((?!https?:|#)([A-Z][\w.]*)\)", _root_link, text)


def _root_link(match: re.Match[str]) -> str:
    text, target = match.groups()
    pages = {"CHANGELOG.md": "release_notes.md", "CONTRIBUTING.md": "contributing.md"}
    return f"[{text}]({pages[target]})" if target in pages else f"`{target}`"
