"""The documentation site is built without a warning, and its notebook runs."""

import html
import os
import re
import subprocess
import sys

import nbformat
import pytest
from nbclient import NotebookClient

from tools.constants import SOURCES, constants
from tools.stored import names, read


def test_site_is_built_without_warnings(repository, tmp_path):
    site = tmp_path / "site"
    environment = os.environ | {"PYTHONPATH": str(repository), "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(site)]
    done = subprocess.run(command, cwd=repository, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    start = (site / "index.html").read_text()
    for page in (
        "constants",
        "docstrings",
        "release_notes",
        "contributing",
        "gallery",
        "report",
        "perceive_a_cloud",
    ):
        assert (site / page / "index.html").is_file()
        assert f'href="{page}/"' in start
    results = (site / "all_results.html").read_text()
    assert 'href="../all_results.html"' in (site / "report" / "index.html").read_text()
    for name in names():
        if name.startswith(("static_", "dynamic_")):
            assert html.escape(read(name).command) in results, name
    docstrings = (site / "docstrings" / "index.html").read_text()
    assert "complete_shape" in docstrings and "Fits" in re.sub("<[^>]+>", "", docstrings)


def test_constants_have_value_comment_and_source():
    found = {(c.module, c.name): c for p in ("feasigrasp", "feasigrasp_lab") for c in constants(p)}
    share = found["feasigrasp.models.tracking.model", "NOISE_SHARE"]
    assert share.value == "0.003" and "normals" in share.comment
    assert ("feasigrasp.models.robot.iiwa", "IIWA_7") not in found
    wrong = [
        at
        for at, c in found.items()
        if not c.comment or re.split(":|,|;", c.source)[0] not in SOURCES
    ]
    assert not wrong, "a comment above ends with 'Source: ...', see docs/developing.md"
    assert len(found) <= 562  # goes down, never up


@pytest.fixture(scope="module")
def notebook(repository):
    return nbformat.read(repository / "examples" / "perceive_a_cloud.ipynb", as_version=4)


def test_notebook_says_of_every_candidate_what_becomes_of_it(notebook, tmp_path, repository):
    resources = {"metadata": {"path": str(tmp_path)}}
    run = NotebookClient(notebook, timeout=250, kernel_name="python3", resources=resources)
    os.environ["PYTHONPATH"] = str(repository)
    text = "".join(
        output.get("text", "") for cell in run.execute().cells for output in cell.get("outputs", [])
    )
    found = re.findall(r"^ *(\d+) ([a-z ]+)$", text, re.MULTILINE)
    verdicts = {what: int(n) for n, what in found if what not in ("grasps", "candidates")}
    (candidates,) = map(int, re.findall(r"(\d+) candidates", text))
    assert verdicts["kept"] > 0 and verdicts["not antipodal"] > 0
    assert sum(verdicts.values()) == candidates


def test_stored_notebook_has_its_pictures(notebook):
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert not [output for output in outputs if output["output_type"] == "error"]
