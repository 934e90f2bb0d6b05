"""``feasigrasp bench soak``: lose and find an object for an hour; record memory and timing."""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.primitives import VectorLogSink

from feasigrasp.models.faults.images import CameraGone
from feasigrasp.models.faults.object import ObjectMoved
from feasigrasp.models.faults.pose import PoseNan
from feasigrasp.one_thread import one_thread
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.tick_times import times_of
from feasigrasp.runs.results.arguments import add_common_arguments, minutes, names, select_objects
from feasigrasp.runs.results.rows import Row, format_rows, report_rows, write_csv
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.runs.plan import add_scenario_arguments

#: The gripper stays open, and the object within reach for most of the time.
SCENARIO = "PaperLinear"
#: Parts of a run: each is measured by itself. Of the first, in which everything is new, nothing is
#: compared; the next `_COMPARED` are the start, the last as many the end.
_PARTS, _COMPARED = 20, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/soak", objects="duck")
    parser.add_argument(
        "--controllers",
        type=names,
        default=["task", "joint"],
        help="Controllers, separated by commas.",
    )
    parser.add_argument(
        "--minutes",
        type=minutes,
        default=60.0,
        help="Simulated time, in minutes. Default: 60; with --quick 1.",
    )
    add_scenario_arguments(parser)


def soak_scenario(args: argparse.Namespace, model: str, controller: str) -> Scenario:
    """The scenario: no pose, no image or no object in reach, again and again.

    Raises:
        ScenarioError: Unknown scenario, key or value.
    """
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    choice = f"{{control: {{controller: {controller}}}}}"
    scenario = load_scenario(filename, SCENARIO, args.scenario_text, choice)
    scenario.random_seed = scenario.tracker.seed = args.seed
    scenario.object.model = model
    scenario.simulation_duration = 60.0 * (1.0 if args.quick else args.minutes)
    scenario.faults = [
        PoseNan(start=8.0, duration=2.0, every=19.0),
        CameraGone(start=12.0, duration=5.0, every=31.0),
        ObjectMoved(start=20.0, duration=6.0, every=43.0),
    ]
    return scenario


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    texts = {
        f"{name}-{controller}": dump_scenario(soak_scenario(args, model, controller))
        for name, model in select_objects(args.objects).items()
        for controller in args.controllers
    }
    found = finish_all(texts, args.out / "runs", {}, soak, jobs=args.jobs, desc="soak")
    write_csv(
        args.out / "parts.csv",
        [{"run": name} | part for name, parts in found.items() for part in parts],
    )
    rows = [row for name, parts in found.items() for row in growth_rows(name, parts)]
    report_rows(args, "bench soak", rows, format_rows(rows))
    return 0


def growth_rows(preset: str, parts: list[Record]) -> list[Row]:
    """How much more memory and time the last parts took than the first."""
    start, end = parts[1 : 1 + _COMPARED], parts[-_COMPARED:]
    rows = []
    for name, key in (("memory", "memory_mib"), ("tick_p99", "tick_p99_us")):
        before, after = (float(np.median([part[key] for part in some])) for some in (start, end))
        growth = 100.0 * (after / before - 1.0)
        rows.append(
            Row.plain(f"faults.soak_{name}_growth_percent", preset, growth, "%", len(parts))
        )
    return rows


def soak(_: str, text: str) -> list[Record]:
    """Runs a scenario, and says what every part of it took.

    Returns:
        Per part: ``until_s`` (simulated), ``wall_s``, ``memory_mib`` (resident, at its end), and
        ``tick_p50_us``, ``tick_p99_us`` of the CPU time of the controller's commands.
    """
    scenario = parse_scenario(text)
    with one_thread():
        diagram = make_dynamic_grasp(scenario)
        ticks = times_of(diagram.GetSubsystemByName("controller"), "velocity", time.thread_time)
        simulator = Simulator(diagram)
        ApplySimulatorConfig(scenario.simulator_config, simulator)
        parts = []
        for until in scenario.simulation_duration * np.arange(1, _PARTS + 1) / _PARTS:
            started = time.perf_counter()
            simulator.AdvanceTo(float(until))
            parts.append(
                {
                    "until_s": float(until),
                    "wall_s": time.perf_counter() - started,
                    "memory_mib": _resident_memory(),
                    "tick_p50_us": 1e6 * float(np.percentile(ticks, 50)),
                    "tick_p99_us": 1e6 * float(np.percentile(ticks, 99)),
                }
            )
            ticks.clear()
            # Logs are for the record of a run, and there is none.
            for system in diagram.GetSystems():
                if isinstance(system, VectorLogSink):
                    system.FindMutableLog(simulator.get_mutable_context()).Clear()
    return parts


def _resident_memory() -> float:
    """What this process occupies [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20
