"""Figures in README and docs are those of stored summaries, and every figure has a source."""

import json
import re

import pytest

from tools import figures
from tools.figures import SUMMARIES, FigureError, pages, read_rows, store, unmarked, updated

STORED = sorted(SUMMARIES.glob("*.json"))


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.name)
def test_figures_are_those_of_the_stored_summaries(page):
    text = page.read_text()
    assert text == updated(text), "run python tools/figures.py, and read what changed"


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.name)
def test_every_figure_says_where_it_comes_from(page):
    found = [f"line {line}, {heading}: {n}" for heading, line, n in unmarked(page.read_text())]
    assert not found, (
        f"{page.name}: figures without a source; docs/developing.md says how to mark one\n"
        + "\n".join(found)
    )


@pytest.mark.parametrize("file", STORED, ids=lambda p: p.stem)
def test_stored_summaries_are_whole(file):
    summary = json.loads(file.read_text())
    assert not summary.get("quick")
    assert re.fullmatch(r"[0-9a-f]{7,40}", summary["git"])
    assert "/" not in re.sub(r"\.\./shared/data/\w+", "", summary["command"]), "a private path"
    keys = [(row["name"], row["preset"]) for row in summary["rows"]]
    assert len(set(keys)) == len(keys)


ROWS = [
    {"name": "held", "preset": "A/task", "value": 98.149, "low": 93.5, "high": 99.5, "n": 108},
    {"name": "held", "preset": "A/joint", "value": 97.0, "low": None, "high": None, "n": 54},
    {"name": "rate", "preset": "new ones", "value": 85321.0, "low": None, "high": None, "n": 9},
    {"name": "rest", "preset": "A/task", "value": -1e-12, "low": None, "high": None, "n": 9},
    {"name": "small", "preset": "A/task", "value": 1.234e-10, "low": None, "high": None, "n": 9},
]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "made_up.json").write_text(json.dumps({"rows": ROWS}))
    return tmp_path


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("97 %<!-- made_up: held A/task -->", "98 %<!-- made_up: held A/task -->"),
        ("**97.0** %<!-- made_up: held A/task -->", "**98.1** %<!-- made_up: held A/task -->"),
        ("1 (2<!-- made_up: held[low] A/task -->)", "1 (94<!-- made_up: held[low] A/task -->)"),
        (
            "of 7<!-- made_up: held[n] A/task --> runs",
            "of 108<!-- made_up: held[n] A/task --> runs",
        ),
        ("1.0 kHz<!-- made_up: rate new ones * 1e-3 -->",) * 2,
        ("1,000<!-- made_up: rate new ones -->", "85,321<!-- made_up: rate new ones -->"),
        ("10 000<!-- made_up: rate new ones -->", "85 321<!-- made_up: rate new ones -->"),
        ("0.1 s<!-- made_up: rest A/task -->", "0.0 s<!-- made_up: rest A/task -->"),
        ("1.0e-9<!-- made_up: small A/task -->", "1.2e-10<!-- made_up: small A/task -->"),
    ],
)
def test_a_marked_number_becomes_that_of_its_row(before, after, folder):
    if before == after:
        after = before.replace("1.0", "85.3")
    assert updated(before, folder) == after
    assert updated(after, folder) == after


@pytest.mark.parametrize(
    ("mark", "message"),
    [
        ("nowhere: held A/task", "store it"),
        ("made_up: lost A/task", "no row lost .*none"),
        ("made_up: held B/task", "no row held .*A/task, A/joint"),
        ("made_up: held[low] A/joint", "has no low"),
    ],
)
def test_a_mark_without_a_row_is_an_error(mark, message, folder):
    with pytest.raises(FigureError, match=message):
        updated(f"98 %<!-- {mark} -->", folder)


def test_a_table_is_made_of_its_template(folder):
    template = """<!-- table: made_up
| which | held | runs |
| {0}, `{1}` | {held:.1f} % | {held[n]:.0f} |
A/task
A/joint
| rate | {rate new ones * 1e-3:.1f} kHz | {rate[n] new ones:.0f} |
-->
{body}<!-- table: end -->"""
    made = updated(template.replace("{body}", "stale\n"), folder)
    assert made.split("-->\n")[1].split("<!--")[0].strip().splitlines() == [
        "| which | held | runs |",
        "|---|---|---|",
        "| A, `task` | 98.1 % | 108 |",
        "| A, `joint` | 97.0 % | 54 |",
        "| rate | 85.3 kHz | 9 |",
    ]
    assert updated(made, folder) == made
    assert not unmarked(made)


def test_the_report_of_stored_summaries_is_made(folder):
    rows = [{**row, "unit": "%"} for row in ROWS]
    summary = {"command": "feasigrasp x", "git": "abc", "seed": 0, "versions": {}, "rows": rows}
    (folder / "made_up.json").write_text(json.dumps(summary))
    page = "<!-- report of: made_up -->\n<!-- report: begin --><!-- report: end -->\nafter\n"
    made = updated(page, folder)
    assert "| `held` | A/task | 98.15 | [93.5, 99.5] | % | 108 |" in made
    assert made.endswith("<!-- report: end -->\nafter\n")
    assert updated(made, folder) == made
    assert not unmarked(made)


def test_what_is_no_figure_is_not_found():
    text = """# Page

It takes 3 ms, in 98.1 % of 5 runs, once in 3 of 18, and 2 s<!-- set --> are set.
`l = 0.3 m`, [a link](https://arxiv.org/abs/2311.02576), 2024, section 5, joint 7,
12 mm<!-- made_up: held A/task -->

```
runs for 5 s
```

| a | b |
|---|---|
| x | 1.5 |

## Protocol

<!-- settings -->

Lifts for 2 s.

## Results

Held 90 %.
"""
    assert [figure for *_, figure in unmarked(text)] == ["3 ms", "98.1 %", "3 of 18", "1.5", "90 %"]
    assert not unmarked("# Page\n\n<!-- settings -->\n\n5 s\n\n## More\n\n6 s\n")


def test_only_what_can_be_relied_on_is_stored(tmp_path):
    file = tmp_path / "summary.json"
    summary = {"command": "feasigrasp x --out out/x --jobs 2 --seed 0", "git": "abc1234"}

    def written(**changes):
        file.write_text(json.dumps({**summary, "rows": ROWS, **changes}))
        return file

    for changes in ({"quick": True}, {"git": "abc1234-dirty"}, {"git": None}):
        with pytest.raises(FigureError):
            store("x", written(**changes), tmp_path)
    stored = store("x", written(), tmp_path / "summaries")
    content = json.loads(stored.read_text())
    assert content == {**summary, "command": "feasigrasp x --seed 0", "rows": ROWS}
    assert len(stored.read_text().splitlines()) < len(ROWS) + 8
    assert read_rows("x", stored.parent)["held", "A/joint"]["n"] == 54
    assert figures.SUMMARIES.name == "summaries"
