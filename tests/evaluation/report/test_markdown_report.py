"""Reports from summaries made by hand."""

import json

import numpy as np
import pytest
from matplotlib.image import imread

from feasigrasp import cli
from feasigrasp.evaluation.report.dynamic import FIGURE
from feasigrasp.evaluation.report.paper_tables import TABLE_2, TABLE_3_JOINT, TABLE_3_TASK
from feasigrasp.results.markdown import BEGIN, END, markdown_table


def row(name, preset, value, low=None, high=None, unit="", n=5):
    return dict(name=name, preset=preset, value=value, low=low, high=high, unit=unit, n=n)


def dynamic_rows(preset, self_collision, limits, manipulability, distance):
    return [
        row("dynamic.self_collision_percent", preset, self_collision, 0.0, self_collision + 1),
        row("dynamic.joint_limit_violation_percent", preset, limits, limits, limits),
        row("dynamic.manipulability_mean", preset, manipulability),
        row(
            "dynamic.gripper_object_distance_cm_mean", preset, distance, distance - 1, distance + 1
        ),
    ]


def write(folder, rows, **more):
    folder.mkdir(parents=True, exist_ok=True)
    summary = {"command": "feasigrasp evaluate dynamic", "git": "abc", "seed": 0}
    summary |= {"versions": {"python": "3.11", "drake": "1.51"}, "rows": rows} | more
    (folder / "summary.json").write_text(json.dumps(summary))


@pytest.fixture
def dynamic(tmp_path):
    folder = tmp_path / "dynamic"
    rows = dynamic_rows("PaperCircular/task/safe", 0.0, 0.0, 0.1234, 9.87)
    rows += dynamic_rows("PaperCircular/task/paper", 7.0, 80.0, 0.08, 1.5)
    rows += dynamic_rows("PaperCircular/task/safe/duck", 0.0, 0.0, 0.12, 9.5)
    rows += [row("dynamic.held_percent", "ReachLinear/joint/safe", 95.0, 80.0, 99.0, "%", 30)]
    write(folder, rows)
    return folder


def lines_of(text):
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]


def test_table_2_has_the_papers_figures_and_ours(dynamic):
    assert cli.main(["report", str(dynamic)]) == 0
    lines = lines_of((dynamic / "report.md").read_text())
    circular = {line[1]: line[2:] for line in lines if line[0] == "Circular"}
    assert list(circular)[:3] == [
        "paper: joint space",
        "paper: task space",
        "paper: grasp diffusion",
    ]
    assert circular["paper: task space"] == [
        "6.72 (5.55)", "89.64 (0.74)", "0.0729 (0.0022)", "3.31 (0.25)",
    ]  # fmt: skip
    ours = circular["**task, safe mode**"]
    assert ours[0] == "**0.00 [0.00, 1.00]**" and ours[1] == "**0.00 [0.00, 0.00]**"
    assert ours[2] == "**0.1234**" and ours[3] == "9.87 [8.87, 10.87]"
    assert circular["**task, paper mode**"][3] == "**1.50 [0.50, 2.50]**"
    assert not [line for line in lines if line[1] == "**joint, safe mode**"]
    assert ["Sinusoidal", "paper: task space"] in [line[:2] for line in lines]


def test_the_other_tables_have_a_line_per_preset(dynamic):
    cli.main(["report", str(dynamic)])
    lines = {line[0]: line[1:] for line in lines_of((dynamic / "report.md").read_text())}
    assert lines["ReachLinear/joint/safe"] == ["95.0 [80.0, 99.0]", "30"]
    assert lines["PaperCircular/task/safe/duck"][-2:] == ["9.50 [8.50, 10.50]", "5"]


def test_the_figure_shows_bars(dynamic):
    cli.main(["report", str(dynamic)])
    picture = imread(dynamic / FIGURE)
    assert picture.shape[0] > 400 and picture.shape[1] > 800
    green = np.abs(picture[..., :3] - np.array([0x23, 0x8B, 0x45]) / 255.0).max(axis=2) < 0.02
    assert green.sum() > 300  # ours


def test_a_report_goes_into_a_document(dynamic, tmp_path):
    document = tmp_path / "docs" / "dynamic.md"
    document.parent.mkdir()
    document.write_text(f"# Title\n\n{BEGIN}\nstale text\n{END}\n\nThe end.\n")
    for _ in range(2):
        assert cli.main(["report", str(dynamic), "--into", str(document)]) == 0
    text = document.read_text()
    assert text.startswith("# Title\n") and text.endswith("\n\nThe end.\n")
    assert "stale" not in text and text.count("Table II") == 1
    assert f"](images/{FIGURE})" in text
    assert (document.parent / "images" / FIGURE).read_bytes() == (dynamic / FIGURE).read_bytes()


@pytest.mark.parametrize("text", [None, "no place\n", f"{END}\n{BEGIN}\n", f"{BEGIN}\n"])
def test_a_document_without_a_place_is_refused_and_kept(dynamic, tmp_path, text, capsys):
    document = tmp_path / "notes.md"
    if text is not None:
        document.write_text(text)
    assert cli.main(["report", str(dynamic), "--into", str(document)]) == 2
    assert "must exist and have one line" in capsys.readouterr().err
    assert (document.read_text() if document.exists() else None) == text


def test_any_summary_and_folders_of_summaries(tmp_path, capsys):
    for name in ("b", "a"):
        rows = [row(f"bench.{name}_ms", "peer:x", 1234.5678, 1200.0, 1300.0, "ms", 7)]
        write(tmp_path / name, rows, command=f"feasigrasp bench {name}", quick=name == "a")
    assert cli.main(["report", str(tmp_path)]) == 0
    text = (tmp_path / "report.md").read_text()
    assert text.index("feasigrasp bench a") < text.index("feasigrasp bench b")
    assert text.count("quick sample") == 1
    assert ["`bench.a_ms`", "peer:x", "1235", "[1200, 1300]", "ms", "7"] in lines_of(text)


def test_a_folder_without_results_is_told(tmp_path, capsys):
    assert cli.main(["report", str(tmp_path)]) == 2
    assert "has a summary.json" in capsys.readouterr().err


def test_tables_of_the_paper_are_complete():
    assert list(TABLE_3_TASK) == list(range(1, 11)) and list(TABLE_3_JOINT) == list(
        range(10, 101, 10)
    )
    assert (TABLE_3_TASK[8], TABLE_3_JOINT[40]) == (81.1, 17.2)
    assert all(len(figures) == 4 for table in TABLE_2.values() for figures in table.values())


def test_a_table_in_markdown():
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"
