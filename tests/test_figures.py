"""Measured figures of README and docs are those of the stored rows."""

import json
import re
import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml
from PIL import Image

from feasigrasp_lab.runs.summary import HANDLING
from tools.figures import PAGES, PICTURE, TABLES, counted_to, filled, made, outdated, sources
from tools.runtime import changed_since
from tools.stored import ROOT, STORE, FigureError, commit_of, names, read, store

SPEC = {
    name: table
    for name, table in yaml.safe_load(TABLES.read_text()).items()
    if not name.startswith("_")
}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_are_those_of_the_stored_rows(page):
    text = page.read_text()
    assert filled(text, *counted_to(text)) == text, "run python tools/figures.py"


def test_the_curves_are_those_of_the_stored_rows():
    assert Image.open(PICTURE).info["Source"] == sources(), "run python tools/figures.py"


def test_a_changed_figure_and_a_changed_age_are_found():
    text = PAGES[0].read_text()
    commit, date = counted_to(text)
    changed = re.sub(r"\d\.\d \(", "0.0 (", text, count=1)
    assert changed != text
    assert filled(changed, commit, date) == text != filled(text, 9999, date)


def test_the_figures_of_readme_are_of_this_code():
    try:
        changed = outdated(PAGES[0].read_text())
    except subprocess.CalledProcessError:
        pytest.skip("this checkout has no history; clone it whole")
    assert changed == {}, "measure again: feasigrasp evaluate all, then tools/figures.py store"


def test_every_table_is_on_a_page():
    text = "".join(page.read_text() for page in PAGES)
    assert set(re.findall(r"<!-- table: (\w+) -->", text)) == set(SPEC)


@pytest.mark.parametrize("page", PAGES[:2], ids=lambda page: page.name)
def test_measured_figures_stand_in_tables_only(page):
    """Shares, computing times and frequencies in prose are those of a definition."""
    text = re.sub(r"<!-- table.*?<!-- end -->|```.*?```", "", page.read_text(), flags=re.DOTALL)
    text = text.replace("95 % interval", "")
    assert not re.findall(r"\d\s?(?:%|ms\b|[uµ]s\b|k?Hz\b)|\d of \d|\d runs", text)


def test_readme_is_right_about_the_limits():
    """Where the rows have limits, none was broken."""
    broken = set()
    for line in SPEC["summary"]["lines"]:
        name, pattern = next(iter(line.values())).split(" ")
        rows = [row for row in read(name).rows.values() if fnmatch(row.preset, pattern)]
        limits = [row for row in rows if row.name.endswith("_violation_percent")]
        assert len({row.name for row in limits}) == (1 if name.startswith("static") else 5), name
        broken |= {(row.name, row.preset) for row in limits if row.value}
    assert broken == set()
    text = PAGES[0].read_text()
    assert "no limit was broken" in text


@pytest.mark.parametrize("name", names())
def test_a_stored_file_says_where_it_comes_from(name):
    stored = read(name)
    assert re.fullmatch(r"[0-9a-f]{7,40}", stored.git) and stored.commit > 0
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", stored.date)
    assert {"cpus", "system", "potrf_1024_ms"} <= set(stored.more["machine"])
    assert "conditions" in stored.more or not name.startswith(("dynamic_", "static_"))
    assert "/" not in re.sub(r"\.\./shared/data/\w+", "", stored.command), "a private path"
    assert "quick" not in stored.more


def row(name, preset, value, low=None, high=None, unit="%", n=54, tuned=True):
    keys = dict(name=name, preset=preset, value=value, low=low, high=high, unit=unit, n=n)
    return keys | {"tuned": tuned}


ROWS = [
    row("dynamic.held_percent", "all/task/safe", 98.149, 93.5, 99.5),
    row("dynamic.held_percent", "all/joint/safe", 100.0),
    row("dynamic.cause.slipped_percent", "all/task/safe", 100.0 / 54),
    row("dynamic.cause.slipped_percent", "all/joint/safe", 0.0),
    row("dynamic.held_percent", "ReachLinear/task/safe", 98.149),
    row("dynamic.held_percent", "ReachLinear/task/safe/soup_can", 50.0, n=2),
    row("dynamic.held_percent", "all/task/safe/soup_can", 50.0, n=2),
    row("dynamic.manipulability_mean", "ReachLinear/task/safe/soup_can", 0.1),
    row("dynamic.lift_cm", "all/task/safe", 9.0, unit="cm"),
    row("dynamic.slip_mm", "all/task/safe", -1e-12, unit="mm"),
    row("dynamic.held_percent", "ReachLinear-ideal/task/safe", 90.0),
    row("dynamic.held_percent", "all-ideal/task/safe", 90.0),
    row("dynamic.held_percent", "circle/0.3", 90.0),
    row("dynamic.held_percent", "all-at-0.3/task/safe", 90.0),
    row("bench.task_hz.1", "default", 58029.4, unit="Hz", n=7),
    row("bench.task_hz.1", "peer:numpy", 6187.6, unit="Hz", n=7),
]
SUMMARY = {"command": "feasigrasp x --out out/x --jobs 2 --seed 3", "seed": 3}


@pytest.fixture
def folder(tmp_path):
    head = commit_of("HEAD")[0]
    (tmp_path / "s.json").write_text(json.dumps(SUMMARY | {"git": "HEAD", "rows": ROWS}))
    store("made_up", tmp_path / "s.json", tmp_path)
    assert read("made_up", tmp_path).commit == head
    return tmp_path


def lines(table, folder, commit=0):
    text = made(table, commit, folder)
    return [line.strip("| ").split(" | ") for line in text.splitlines() if "|" in line][2:]


def test_a_table_by_preset(folder):
    table = {
        "columns": "held_percent, slip = slip_mm, failures, failed objects, runs",
        "lines": [{"{1} of {0:a}": "made_up all/*/safe"}],
    }
    assert lines(table, folder) == [
        ["task of ll", "98.1 (94 - 100)", "0.0", "slipped 1", "soup can 1", "54"],
        ["joint of ll", "100.0", "", "none", "none", "54"],
    ]
    heads = made(table, 0, folder).splitlines()[0]
    assert "grasp success [%] `held_percent` | slip |" in heads


def test_a_table_by_row_and_figures_side_by_side(folder):
    table = {
        "presets": "paper, ours = default, peers = peer:*",
        "lines": [{"one": "paper bench.task_hz.1 + made_up bench.task_hz.1"}],
    }
    assert lines(table, folder) == [["one", "107 Hz", "58,029 Hz", "numpy 6,188 Hz"]]
    both = {"columns": "held_percent", "lines": ["made_up circle/0.3 + made_up all/joint/safe"]}
    assert lines(both, folder) == [["circle/0.3", "90.0 / 100.0"]]


def test_revision_and_age_stand_below_or_in_a_column(folder):
    stored = read("made_up", folder)
    table = {"columns": "held_percent", "lines": ["made_up circle/0.3"]}
    text = made(table, stored.commit + 12, folder)
    assert text.endswith(f"\n\n`made_up`: {stored.git[:7]}, age 12.")
    column = made(table | {"columns": "runs, revision and age"}, stored.commit + 12, folder)
    assert column.endswith(f"| {stored.git[:7]}, age 12 |")


def test_success_of_runs_of_which_constants_were_chosen_on_some_is_not_printed(tmp_path):
    rows = [row("dynamic.held_percent", "circle/0.6", 78.0, tuned=None)]
    (tmp_path / "s.json").write_text(json.dumps(SUMMARY | {"git": "HEAD", "rows": rows}))
    store("pooled", tmp_path / "s.json", tmp_path)
    with pytest.raises(FigureError, match="constants were chosen on some"):
        made({"columns": "held_percent", "lines": ["pooled circle/0.6"]}, 0, tmp_path)


def test_columns_of_all_tables_of_moving_objects():
    """What the arm did to the object, and its true acceleration."""
    shared = yaml.safe_load(TABLES.read_text())["_handling"]
    assert tuple(column.rpartition(" = ")[2] for column in shared.split(", ")) == HANDLING
    success = re.compile(r"= held_percent|^held_percent")
    for name, table in SPEC.items():
        if success.search(table.get("columns", "")):
            assert "*handling" in table["columns"], name


def test_a_column_that_no_line_has_is_named_below(folder):
    table = {"columns": "held_percent, impulse [N s] = contact_impulse_n_s"}
    text = made(table | {"lines": ["made_up all/task/safe"]}, 0, folder)
    assert "impulse" not in text.splitlines()[0]
    assert text.endswith(" Not measured: impulse.")


@pytest.mark.parametrize("source", ["nowhere all/*/safe", "made_up all/lost/safe"])
def test_what_is_not_stored_is_an_error(folder, source):
    with pytest.raises(FigureError, match=r"not stored|neither row nor preset"):
        made({"columns": "held_percent", "lines": [source]}, 0, folder)


def test_rows_of_groups_are_stored_and_of_objects_only_success(folder):
    stored = read("made_up", folder)
    left_out = {
        ("dynamic.held_percent", "all/task/safe/soup_can"),
        ("dynamic.manipulability_mean", "ReachLinear/task/safe/soup_can"),
        ("dynamic.lift_cm", "all/task/safe"),
        ("dynamic.held_percent", "ReachLinear-ideal/task/safe"),
        ("dynamic.held_percent", "all-at-0.3/task/safe"),
    }
    assert set(stored.rows) == {(r["name"], r["preset"]) for r in ROWS} - left_out
    assert stored.rows["bench.task_hz.1", "default"].value == 58029.0  # five digits
    assert stored.command == "feasigrasp x --seed 3"


@pytest.mark.parametrize(
    "change", [{"quick": True}, {"partial": True}, {"git": "abc1234-dirty"}, {"git": None}]
)
def test_samples_and_changed_checkouts_are_not_stored(tmp_path, change):
    file = Path(tmp_path / "s.json")
    file.write_text(json.dumps(SUMMARY | {"git": "HEAD", "rows": ROWS} | change))
    with pytest.raises(FigureError):
        store("x", file, tmp_path)


#: What every revision of a repository has.
CELL = {"feasigrasp/b.py": "", "models/a.obj": "v", "diagrams/dynamic.scenarios.yaml": ""}


@pytest.fixture
def repository_of_two(tmp_path):
    """``commit(files)`` writes files of a small repository and commits them."""

    def git(*command):
        name = ("-c", "user.name=x", "-c", "user.email=x")
        subprocess.run(["git", *name, *command], cwd=tmp_path, check=True, capture_output=True)

    def commit(files):
        for path, text in (CELL | files).items():
            (tmp_path / path).parent.mkdir(exist_ok=True)
            (tmp_path / path).write_text(text)
        git("add", ".")
        git("commit", "-qm", "x")

    git("init", "-q")
    return commit


@pytest.mark.parametrize(
    ("path", "before", "after", "changed"),
    [
        ("feasigrasp/a.py", '"""Says."""\nA = 1\n', '"""Says more."""\nA = 1  # of it\n', False),
        ("feasigrasp/a.py", 'def f():\n    """Says."""\n', "def f():\n    pass\n", True),
        ("feasigrasp/a.py", "A = 1\n", "A = 2\n", True),
        ("feasigrasp/a.py", "A = 1\n", "A = '1'\n", True),
        ("feasigrasp/a.pyi", "A: int\n", "A: float\n", False),
        ("models/a.obj", "v", "v 1", True),
        ("models/new.obj", None, "v", True),
        ("tests/a.py", "A = 1\n", "A = 2\n", False),
    ],
)
def test_words_about_code_do_not_make_figures_outdated(
    repository_of_two, tmp_path, path, before, after, changed
):
    repository_of_two({} if before is None else {path: before})
    repository_of_two({path: after})
    assert changed_since("HEAD~1", root=tmp_path) == [path] * changed


def test_the_store_is_package_data():
    assert STORE.is_relative_to(ROOT / "feasigrasp_lab") and len(names()) > 25
