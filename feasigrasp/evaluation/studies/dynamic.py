"""``feasigrasp evaluate dynamic``: scenarios x controllers x modes x objects x seeds.

Without options it runs everything behind the tables in ``docs/dynamic.md``; ``--study`` chooses a
part of it. Every run is a file of its own: repeated, the command goes on where it was.
"""

from __future__ import annotations

import argparse
import csv
import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import joblib
from tqdm import tqdm

from feasigrasp.evaluation.runs.finished import finished_records
from feasigrasp.evaluation.runs.isolated import run_isolated
from feasigrasp.evaluation.runs.plan import PlannedRun, add_plan_arguments, plan
from feasigrasp.evaluation.runs.summary import format_table, summary_rows
from feasigrasp.results.arguments import add_common_arguments
from feasigrasp.results.provenance import git_revision
from feasigrasp.results.rows import write_summary

Record = dict[str, Any]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/dynamic", objects=None)
    add_plan_arguments(parser)


def run_all(runs: Sequence[PlannedRun], folder: Path, jobs: int) -> Iterator[Record]:
    """Runs everything, each in its own process, and yields the records as they come.

    The threads only wait for those processes; joblib's ``parallel_config`` can send the runs to a
    cluster instead.
    """
    parallel = joblib.Parallel(jobs, prefer="threads", return_as="generator_unordered")
    yield from parallel(
        joblib.delayed(run_isolated)(planned.scenario, planned.name, folder / f"{planned.id}.json")
        for planned in runs
    )


def write_csv(records: Sequence[Record], filename: Path) -> None:
    """Writes one row per run with all its metrics."""
    heads = ("scenario", "controller", "mode", "object", "seed", "git")
    rows = [
        {head: record[head] for head in heads}
        | record["metrics"]
        | record["timings"]
        | {"error": record["error"]}
        for record in records
    ]
    with filename.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = plan(args)
    revision = git_revision()
    folder = args.out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    records = finished_records(runs, folder, revision)
    missing = [planned for planned in runs if planned.id not in records]
    _report_reuse(runs, missing, folder, revision)
    with tqdm(total=len(runs), initial=len(records), unit="run", desc="dynamic") as bar:
        try:
            for record in run_all(missing, folder, args.jobs):
                bar.update()
                if record["error"]:
                    bar.write(f"{record['scenario']}, {record['object']}: {record['error'][:200]}")
        except KeyboardInterrupt:
            bar.write("interrupted; the same command goes on from here")
            return 130
    # From the files: they are what a later command finds too, and their order is the plan's.
    finished = [json.loads((folder / f"{planned.id}.json").read_text()) for planned in runs]
    rows = summary_rows(finished)
    write_csv(finished, args.out / "runs.csv")
    write_summary(
        args.out / "summary.json",
        command=_command(args),
        git=revision,
        seed=args.seed,
        rows=rows,
        quick=args.quick,
    )
    print(format_table(rows))
    others = sorted({str(record["git"]) for record in finished} - {str(revision)})
    if others:
        print(f"the code changed meanwhile: some runs are of {', '.join(others)}, not {revision}")
    print(f"{args.out / 'summary.json'}, {args.out / 'runs.csv'}, {folder}/*.json")
    return 0


def _command(args: argparse.Namespace) -> str:
    options = {
        "--study": args.study if args.scenarios is None else None,
        "--scenarios": ",".join(args.scenarios or ()) or None,
        "--objects": args.objects,
        "--controllers": ",".join(args.controllers),
        "--mode": ",".join(args.mode or ()) or None,
        "--seed": args.seed,
        "--seeds": args.seeds,
        "--scenario_file": args.scenario_file,
        "--scenario_text": args.scenario_text,
    }
    words = [str(x) for key, value in options.items() if value is not None for x in (key, value)]
    return shlex.join(["feasigrasp", "evaluate", "dynamic", *words, *["--quick"] * args.quick])


def _report_reuse(
    runs: Sequence[PlannedRun],
    missing: Sequence[PlannedRun],
    folder: Path,
    revision: str | None,
) -> None:
    outdated = sum((folder / f"{planned.id}.json").exists() for planned in missing)
    kept = len(runs) - len(missing)
    if outdated:
        print(f"{outdated} results are from another revision or setting, or crashed: run again")
    if kept:
        print(f"{kept} of {len(runs)} runs are finished already in {folder}")
        if (revision or "").endswith("-dirty"):
            print("  uncommitted changes cannot be told apart: use a new --out after changing code")
