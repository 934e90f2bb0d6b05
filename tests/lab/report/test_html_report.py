"""The page of a folder of results: whole in itself, with curves, objects and failures."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.image import imread

from feasigrasp import cli
from feasigrasp.runs.run import crash_record
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.report.html_report import markdown_html, outcomes_of_rows, worst_failures
from feasigrasp_lab.report.tables import FIGURE, curve_points, markdown_table
from feasigrasp_lab.results.rows import Row


def row(name, preset, value, low=None, high=None, n=12):
    return dict(name=name, preset=preset, value=value, low=low, high=high, unit="%", n=n)


def run_record(model, seed, held, **metrics):
    made = crash_record(Scenario(), "ReachCircularMocap-at-0.3", "") | {"error": None, "seed": seed}
    made["object"] = model
    made["metrics"] |= {"grasp_held": held, "cause": None if held else "slipped"} | metrics
    return made


@pytest.fixture
def folder(tmp_path):
    rows = []
    points = {"circle/0.15": 100.0, "circle/0.6": 40.0, "bezier/0.3": 80.0, "line-camera/0.3": 70.0}
    for preset, held in points.items():
        rows += [
            row("dynamic.held_percent", preset, held, held - 10, min(100.0, held + 9)),
            row("dynamic.closing_speed_m_s", preset, 0.123),
            row("dynamic.cause.slipped_percent", preset, 100.0 - held),
        ]
    summary = {"command": "feasigrasp evaluate dynamic --study speed", "git": "abc", "seed": 0}
    summary |= {"versions": {"python": "3.11"}, "rows": rows}
    (tmp_path / "runs").mkdir()
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    for name, record in {
        "a": run_record("mug", 0, True),
        "b": run_record("mug", 1, False, pushed_mm=12.0),
        "c": run_record("<none>", 0, False, pushed_mm=70.0),
        "d": run_record("ball", 0, False) | {"error": "the solver failed"},
    }.items():
        (tmp_path / "runs" / f"{name}.json").write_text(json.dumps(record))
    (tmp_path / "runs" / "c.html").write_text("a replay")
    assert cli.main(["report", str(tmp_path), "--html"]) == 0
    return tmp_path


class Page(HTMLParser):
    """Tags that are open, sources, links and text."""

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.links, self.text = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.sources += [attrs["src"]] if "src" in attrs else []
        self.links += [attrs["href"]] if "href" in attrs else []
        if tag not in ("img", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def page(folder):
    parser = Page()
    parser.feed((folder / "report.html").read_text())
    assert parser.open == []
    return parser


def test_the_page_needs_nothing_beside_it(page):
    assert page.sources and all(source.startswith("data:image/png") for source in page.sources)
    assert page.links == ["runs/c.html"]


def test_it_says_what_the_markdown_says_and_more(page, folder):
    text = re.sub(r"\s+", " ", page.text)
    assert "Success over speed" in text and "40.0 [30.0, 49.0]" in text
    assert "slipped [%]" in text and "60.0" in text
    assert "1 of 2 held" in text and "0 of 1 held" in text
    assert "<none>" in text and "the solver failed" in text
    assert len(page.sources) == 1  # the curve


def test_without_its_runs_the_objects_are_those_of_the_summary(tmp_path):
    """Every run of an object counts once: not in the mean of all, nor in a point of a curve."""
    line, circle = "ReachLinearMocap/task/safe", "ReachCircularMocap/task/safe"
    rows = [
        row("dynamic.held_percent", f"{line}/mug", 75.0, n=4),
        row("dynamic.held_percent", f"{circle}/mug", 0.0, n=1),
        row("dynamic.held_percent", "all/task/safe/mug", 60.0, n=5),
        row("dynamic.held_percent", line, 75.0, n=8),
        row("dynamic.held_percent", "circle/0.15", 75.0, n=8),
        row("dynamic.pushed_percent", f"{line}/mug", 100.0, n=4),
        row("static.object_held_percent", "honest/some_mesh", 100.0 / 3.0, n=3),
    ]
    assert outcomes_of_rows([Row(**each) for each in rows]) == {"mug": (3, 5), "some_mesh": (1, 3)}
    summary = {"command": "feasigrasp evaluate static", "git": "abc", "seed": 0, "rows": rows[-1:]}
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        text = json.dumps(summary | {"versions": {"python": "3.11"}})
        (tmp_path / name / "summary.json").write_text(text)
    assert cli.main(["report", str(tmp_path), "--html"]) == 0
    page = (tmp_path / "report.html").read_text()
    assert page.count("1 of 3 held") == 2 and "worst failures" not in page


def test_what_broke_off_comes_first_then_the_farthest_pushed(folder):
    records = {file: json.loads(file.read_text()) for file in folder.glob("runs/*.json")}
    assert [file.stem for file in worst_failures(records)] == ["d", "c", "b"]


def test_curves_are_in_order_of_speed_and_drawn(folder):
    rows = json.loads((folder / "summary.json").read_text())["rows"]
    found = {(r["preset"], r["name"].removeprefix("dynamic.")): Row(**r) for r in rows}
    assert curve_points(found, "circle") == [(0.15, "circle/0.15"), (0.6, "circle/0.6")]
    assert curve_points(found, "line-camera") == [(0.3, "line-camera/0.3")]
    assert curve_points(found, "line") == curve_points(found, "spin") == []
    picture = imread(folder / FIGURE)[..., :3]
    green = np.abs(picture - np.array([0x23, 0x8B, 0x45]) / 255.0).max(axis=2) < 0.02
    assert green.sum() > 100
    blue = np.abs(picture - np.array([0x21, 0x71, 0xB5]) / 255.0).max(axis=2) < 0.02
    assert blue.sum() > 20


def test_markdown_becomes_html():
    table = markdown_table(["a", "b"], [["`x<y`", "**1**"]])
    made = markdown_html(f"## Head\n\n![fig](f.png)\n\n{table}\n\nA & B", {"f.png": "data:x"})
    assert made.splitlines() == [
        "<h2>Head</h2>",
        '<img src="data:x" alt="fig">',
        '<div class="wide"><table><tr><th>a</th><th>b</th></tr>'
        "<tr><td><code>x&lt;y</code></td><td><strong>1</strong></td></tr></table></div>",
        "<p>A &amp; B</p>",
    ]
