"""``feasigrasp run``: simulate one grasp of a moving object, and report its outcome.

It prints whether the object was held, what went on, and the figures of
``docs/results_schema.md``; on a terminal one line says meanwhile how far it is.
"""

import argparse
import json
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pydot
import yaml

from feasigrasp.commands.warm_up import compile_in_advance
from feasigrasp.errors import FeasigraspError, OutputError
from feasigrasp.models.choices import controller_names, mode_names
from feasigrasp.models.robot.arm_file import arm_names
from feasigrasp.outputs import check_outputs, replacing, write_json, write_text
from feasigrasp.resources import diagram_path
from feasigrasp.runs.console import StatusLine, summary
from feasigrasp.runs.hardware.control import run_hardware
from feasigrasp.runs.live import LiveView
from feasigrasp.runs.replay import quiet_meshcat
from feasigrasp.runs.results.arguments import output, print_notes, share
from feasigrasp.runs.results.interrupts import STATUS
from feasigrasp.runs.run import INTERRUPTED, run
from feasigrasp.scenario.files import PACKAGED, load_scenario, only_scenario
from feasigrasp.scenario.parts import load_part
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.scenario.schema import ControlConfig, Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.hardware.channels import LCM_URL
from feasigrasp.warm_up import GROUPS, is_warm

#: What runs if nothing else is asked for.
DEFAULT_SCENARIO = "ReachCircular"
_OF_SCENARIO = "Default: the scenario's."
#: Share of its velocity limits that an arm on hardware may use unless scenario or option say
#: otherwise: a choice, at which the joints that are quickest turn at 45 deg/s. Source: reasoned.
HARDWARE_SPEED = 0.25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_scenario_name(parser)
    add_options(parser)


def add_scenario_name(parser: argparse.ArgumentParser) -> None:
    """Adds the name of the scenario."""
    parser.add_argument(
        "scenario_name",
        nargs="?",
        metavar="SCENARIO",
        help=f"Scenario; see 'feasigrasp scenarios'. Default: {DEFAULT_SCENARIO}, or the only one "
        "of --scenario-file.",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds all arguments but the name of the scenario."""
    add_scenario_options(parser)
    parser.add_argument(
        "--replay",
        type=output(".html", ""),
        metavar="FILE.html",
        help="Write a replay to this page.",
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="Show the run in a browser at real time, with pause and a slider for the speed.",
    )
    parser.add_argument(
        "--ghost",
        choices=mode_names(),
        help="Simulate the arm in this mode too, and show it translucent in the replay.",
    )
    parser.add_argument(
        "--results", type=output(".json", ""), metavar="FILE.json", help="Write the run's record."
    )
    parser.add_argument(
        "--log",
        type=output(".npz", ""),
        metavar="FILE.npz",
        help="Write joints, commands, poses and the chosen grasp here, at every tick of the "
        "control; see docs/results_schema.md.",
    )
    parser.add_argument("--graphviz", type=Path, metavar="FILE", help="Draw the diagram and stop.")
    parser.add_argument(
        "--hardware",
        action="store_true",
        help="Command an arm by its driver's messages; see docs/hardware.md. Object and motion of "
        "the scenario are then not used.",
    )
    parser.add_argument(
        "--no-guard",
        action="store_true",
        help="With --hardware: start no guard, since 'feasigrasp guard' runs beside the driver.",
    )


def add_lcm_option(parser: argparse.ArgumentParser) -> None:
    """Adds the option for the URL of the LCM bus."""
    parser.add_argument(
        "--lcm-url", default=LCM_URL, metavar="URL", help="Address of the drivers' messages."
    )


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """Adds those that choose a scenario, and change it, and where its drivers are."""
    add_lcm_option(parser)
    parser.add_argument(
        "--scenario-file", type=Path, help="File of scenarios. Default: the packaged ones."
    )
    parser.add_argument(
        "--scenario-text", metavar="YAML", help="YAML applied on top of the scenario."
    )
    spaces, modes = controller_names(), mode_names()
    parser.add_argument("--controller", choices=spaces, help=f"Controller. {_OF_SCENARIO}")
    parser.add_argument(
        "--mode",
        choices=modes,
        help=f"Mode of the controller: 'safe' enforces limits and clearances. {_OF_SCENARIO}",
    )
    parser.add_argument(
        "--arm", help=f"One of {', '.join(arm_names())}, or the file of an arm. {_OF_SCENARIO}"
    )
    parser.add_argument("--object", help=f"Built-in object, or a mesh file. {_OF_SCENARIO}")
    parser.add_argument("--seed", type=int, help=f"Random seed. {_OF_SCENARIO}")
    parser.add_argument(
        "--duration", type=float, help=f"Longest simulated time, in seconds. {_OF_SCENARIO}"
    )
    parser.add_argument(
        "--speed",
        type=share,
        metavar="PERCENT",
        help="Share of the arm's velocity limits that may be used, e.g. 20%% or 0.2. Default: the "
        f"scenario's, else 100%%; on hardware {100 * HARDWARE_SPEED:.0f}%%.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    outputs = {name: getattr(args, name) for name in ("replay", "results", "log", "graphviz")}
    check_outputs({f"--{name}": file for name, file in outputs.items()}, files_read(args))
    name, scenario = load(args, on_hardware=args.hardware)
    for key, part in scenario.parts.items():
        load_part(key, part)
    print_notes(load_scenario_object(scenario))
    if args.graphviz is not None:
        draw_diagram(scenario, args.graphviz)
        return 0
    if args.hardware and (args.replay is not None or args.live):
        raise FeasigraspError(
            "--replay and --live show what is simulated; with --hardware leave them out, or give "
            "them to 'feasigrasp run' without"
        )
    if args.no_guard and not args.hardware:
        raise FeasigraspError("--no-guard says who commands an arm; give it with --hardware")
    if args.ghost is not None and args.replay is None:
        raise FeasigraspError("--ghost is shown in a replay; give --replay FILE.html as well")
    ghost = load(argparse.Namespace(**vars(args) | {"mode": args.ghost}))[1] if args.ghost else None
    if text := speed_text(scenario.control.speed, on_hardware=args.hardware):
        print(text, flush=True)
    groups = {str(scenario.control.controller)} & set(GROUPS)  # baselines compile as they go
    if not is_warm(groups):
        compile_in_advance(groups)
    live = LiveView(quiet_meshcat()) if args.live else None
    if live is not None:
        print(f"open {live.url} in a browser; the run starts there, or with Enter", flush=True)
    line = StatusLine()
    kept = partial(keep, results=args.results, line=line)
    given: dict[str, Any] = {"log": args.log is not None, "keep": kept, "line": line}
    try:
        if args.hardware:
            result = run_hardware(scenario, name, args.lcm_url, not args.no_guard, **given)
        else:
            result = run(scenario, name, replay=args.replay, live=live, ghost=ghost, **given)
    finally:
        line.clear()
    if args.log is not None:
        result.write_log(args.log)
    for filename in filter(None, (args.results, args.replay, args.log)):
        print(f"wrote {filename}")
    if live is not None and result.record["error"] != INTERRUPTED:
        live.stay()
    return {None: 0, INTERRUPTED: STATUS}.get(result.record["error"], 1)


def files_read(args: argparse.Namespace) -> dict[str, Path | str | None]:
    """Input files by the option that names them; no output may overwrite them."""
    return {"--scenario-file": args.scenario_file, "--object": args.object}


def load(args: argparse.Namespace, *, on_hardware: bool = False) -> tuple[str, Scenario]:
    """Name and content of the scenario that the command line asks for.

    An arm ``on_hardware`` is slow unless scenario or command line say otherwise.
    """
    filename, name = args.scenario_file, args.scenario_name
    if filename is None:
        filename, name = diagram_path(PACKAGED), name or DEFAULT_SCENARIO
    name = name or only_scenario(filename)
    chosen = {
        "control": _given(controller=args.controller, mode=args.mode, speed=args.speed),
        "object": _given(model=args.object),
        **_given(arm=args.arm, random_seed=args.seed, simulation_duration=args.duration),
    }
    changes = {key: value for key, value in chosen.items() if value != {}}
    options = yaml.safe_dump(changes, default_flow_style=True) if changes else None
    base = Scenario(control=ControlConfig(speed=HARDWARE_SPEED)) if on_hardware else None
    return name, load_scenario(filename, name, args.scenario_text, options, base=base)


def speed_text(speed: float, *, on_hardware: bool) -> str:
    """Console text of the arm's speed limit; empty at full speed."""
    if speed == 1.0 and not on_hardware:
        return ""
    more = "" if speed == 1.0 else "; --speed 100% or control: {speed: 1} for all of them"
    return f"speed: {100 * speed:.3g}% of the arm's velocity limits{more}"


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
            f"--graphviz {filename}: Graphviz has no format {picture!r}; end it in .svg, .png or "
            ".dot"
        ) from error
    except FileNotFoundError as error:
        raise FeasigraspError(
            f"--graphviz {filename} needs the program 'dot': install the package graphviz, or "
            "give a file that ends in .dot"
        ) from error
    with replacing(filename) as file:
        file.write(drawn)


def keep(record: dict[str, Any], results: Path | None, line: StatusLine) -> None:
    """Prints what a run brought, and writes it; a full disk leaves it on the console."""
    line.clear()
    with suppress(BrokenPipeError):  # its reader is gone; the record is written all the same
        print(*summary(record), sep="\n", flush=True)
    if results is not None:
        try:
            write_json(record, results)
        except OutputError:
            print(json.dumps(record))
            raise
