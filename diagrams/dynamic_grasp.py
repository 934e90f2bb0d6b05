"""An iiwa follows, grasps and lifts a moving object: build a scenario's diagram and run it.

For example::

    python diagrams/dynamic_grasp.py --scenario_name ReachCircular --controller task \
        --object mug --replay out/replay.html --results out/results.json
"""

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pydot
import yaml

from feasigrasp.errors import FeasigraspError, OutputError
from feasigrasp.evaluation.runs.run import INTERRUPTED, run
from feasigrasp.models.control.mode import ControlMode, ControlSpace
from feasigrasp.outputs import check_outputs, replacing, write_text
from feasigrasp.results.arguments import print_notes
from feasigrasp.results.interrupts import STATUS
from feasigrasp.results.rows import write_json
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

SCENARIO_FILE = Path(__file__).with_name("dynamic.scenarios.yaml")


def parse_arguments() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario_file", type=Path, default=SCENARIO_FILE)
    parser.add_argument("--scenario_name", default="ReachCircular")
    parser.add_argument("--scenario_text", help="YAML applied on top of the scenario")
    parser.add_argument("--controller", choices=[*map(str, ControlSpace)])
    parser.add_argument("--mode", choices=[*map(str, ControlMode)])
    parser.add_argument("--object", help="name of a built-in object, or a mesh file")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--duration", type=float, help="simulated seconds at most")
    parser.add_argument("--replay", type=Path, help="write an HTML replay here")
    parser.add_argument("--results", type=Path, help="write the result as JSON here")
    parser.add_argument("--graphviz", type=Path, help="draw the diagram here and stop")
    return parser.parse_args()


def load(args: argparse.Namespace) -> Scenario:
    """The scenario that the command line asks for."""
    chosen = {
        "control": _given(controller=args.controller, mode=args.mode),
        "object": _given(model=args.object),
        **_given(random_seed=args.seed, simulation_duration=args.duration),
    }
    text = yaml.safe_dump(chosen)
    return load_scenario(args.scenario_file, args.scenario_name, args.scenario_text, text)


def _given(**options: object) -> dict[str, object]:
    return {key: value for key, value in options.items() if value is not None}


def draw_diagram(scenario: Scenario, filename: Path) -> None:
    """Draws a scenario's diagram; a ``.dot`` file needs nothing, pictures need Graphviz."""
    text = make_dynamic_grasp(scenario).GetGraphvizString(max_depth=1)
    picture = filename.suffix.lstrip(".")
    if picture in ("", "dot"):
        write_text(filename, text)
        return
    graphs: Any = pydot.graph_from_dot_data(text) or []
    try:
        drawn: bytes = graphs[0].create(format=picture)
    except AssertionError as error:
        raise FeasigraspError(
            f"--graphviz {filename}: Graphviz knows no format {picture!r}; end it in .svg, .png or "
            ".dot"
        ) from error
    except FileNotFoundError as error:
        raise FeasigraspError(
            f"--graphviz {filename} needs the program 'dot': install the package graphviz, or "
            "give a file that ends in .dot"
        ) from error
    with replacing(filename) as file:
        file.write(drawn)


def print_table(record: dict) -> None:
    """Prints what a run brought."""
    timings, metrics = record["timings"], record["metrics"]
    print(f"{record['scenario']}, {record['controller']} space, {record['object']}")
    print(f"  {'simulated':36s} {timings['simulated_s']:8.2f} s")
    print(f"  {'real-time factor':36s} {timings['real_time_factor']:8.2f}")
    for name, value in metrics.items():
        text = f"{value:.3f}" if isinstance(value, float) else str(value)
        print(f"  {name:36s} {text:>8s}")
    if record["error"]:
        print(f"  the simulation broke off: {record['error']}")


def keep(record: dict, results: Path | None) -> None:
    """Prints what a run brought, and writes it; a full disk leaves it on the console."""
    print_table(record)
    if results is not None:
        try:
            write_json(record, results)
        except OutputError:
            print(json.dumps(record))
            raise


def main() -> int:
    """Runs one scenario."""
    args = parse_arguments()
    outputs = {name: getattr(args, name) for name in ("replay", "results", "graphviz")}
    try:
        check_outputs({f"--{name}": filename for name, filename in outputs.items()})
        scenario = load(args)
        print_notes(load_scenario_object(scenario))
        if args.graphviz is not None:
            draw_diagram(scenario, args.graphviz)
            return 0
        name, results = args.scenario_name, args.results
        result = run(scenario, name, replay=args.replay, keep=partial(keep, results=results))
    except FeasigraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return STATUS
    return {None: 0, INTERRUPTED: STATUS}.get(result.record["error"], 1)


if __name__ == "__main__":
    sys.exit(main())
