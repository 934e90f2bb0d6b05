"""The ``feasigrasp`` command: ``feasigrasp evaluate dynamic`` and so on.

A command is a module with ``add_arguments(parser)`` and ``main(args) -> int``, listed in
`COMMANDS`; it is imported only when it is asked for.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from feasigrasp import __version__
from feasigrasp.errors import FeasigraspError

#: What each group of commands is for.
GROUPS = {
    "evaluate": "measure how well it works",
    "bench": "measure how quick it is",
    "fit": "fit models to an arm, and to grasps",
    "train": "train the networks that come with the package",
}

#: By group and name: the module, and what it does.
COMMANDS = {
    ("evaluate", "shape"): (
        "feasigrasp.evaluation.studies.shape",
        "compare completed shapes with the true ones",
    ),
    ("evaluate", "length-scale"): (
        "feasigrasp.evaluation.studies.length_scale",
        "repeat the paper's search for the best length scale",
    ),
    ("evaluate", "shape-figures"): (
        "feasigrasp.evaluation.studies.shape_figures",
        "draw what the distance field does, for the documentation",
    ),
    ("evaluate", "kinematics"): (
        "feasigrasp.evaluation.studies.kinematics",
        "compare the arm's kinematics with Drake and with itself",
    ),
    ("evaluate", "reachability"): (
        "feasigrasp.evaluation.studies.reachability",
        "compare the reachable space with exact inverse kinematics",
    ),
    ("evaluate", "capability"): (
        "feasigrasp.evaluation.studies.capability",
        "draw what the arm can reach",
    ),
    ("evaluate", "grasp-labels"): (
        "feasigrasp.evaluation.studies.grasp_labels",
        "try out in simulation what the labels of the grasp network call valid",
    ),
    ("evaluate", "sampler"): (
        "feasigrasp.evaluation.studies.sampler",
        "judge the grasps of objects that were never trained on",
    ),
    ("evaluate", "sampler-figures"): (
        "feasigrasp.evaluation.studies.sampler_figures",
        "draw grasps before and after the filter, for the documentation",
    ),
    ("evaluate", "grasp-targets"): (
        "feasigrasp.evaluation.studies.grasp_targets",
        "count how many means and medoids of grasp mixtures are grasps",
    ),
    ("evaluate", "dynamic"): (
        "feasigrasp.evaluation.studies.dynamic",
        "follow, grasp and lift moving objects",
    ),
    ("evaluate", "prediction"): (
        "feasigrasp.evaluation.studies.prediction",
        "compare the tracked and predicted motion of objects with the true one",
    ),
    ("evaluate", "rollout"): (
        "feasigrasp.evaluation.studies.rollout",
        "follow moving objects without physics, to tune controllers",
    ),
    ("evaluate", "gallery"): (
        "feasigrasp.evaluation.studies.gallery",
        "record one replay per row of the dynamic table, and a page that links them",
    ),
    ("bench", "shape"): (
        "feasigrasp.evaluation.bench.shape",
        "time the distance field beside its peers",
    ),
    ("bench", "kinematics"): (
        "feasigrasp.evaluation.bench.kinematics",
        "time the arm's kinematics beside its peers",
    ),
    ("bench", "reachability"): (
        "feasigrasp.evaluation.bench.reachability",
        "time the reachability filter and its fit",
    ),
    ("bench", "safety"): (
        "feasigrasp.evaluation.bench.safety",
        "compare ways to keep the arm inside its limits and clear of everything",
    ),
    ("bench", "control"): (
        "feasigrasp.evaluation.bench.control",
        "time the controllers beside the paper's figures and their peers",
    ),
    ("bench", "sampler"): (
        "feasigrasp.evaluation.bench.sampler",
        "time the way from a cloud to grasps",
    ),
    ("bench", "all"): (
        "feasigrasp.evaluation.bench.all",
        "run all benchmarks, one after the other",
    ),
    ("fit", "reachability"): (
        "feasigrasp.training.fit_reachability",
        "fit the reachable space of an arm",
    ),
    ("fit", "certainty"): (
        "feasigrasp.training.fit_certainty",
        "fit how far field and network are believed about grasps",
    ),
    ("train", "ik-flow"): (
        "feasigrasp.training.train_ik_flow",
        "train the flow that proposes inverse kinematics",
    ),
    ("train", "hidden-side"): (
        "feasigrasp.training.train_hidden_side",
        "train what is expected behind the seen side of an object",
    ),
    ("train", "sampler-data"): (
        "feasigrasp.training.sampler_data",
        "make the training data of the grasp network",
    ),
    ("train", "sampler"): (
        "feasigrasp.training.train_sampler",
        "train the network that proposes grasps",
    ),
}

#: Commands without a group, likewise.
SINGLE_COMMANDS = {
    "report": (
        "feasigrasp.evaluation.report.markdown_report",
        "write what a folder of results says as Markdown",
    ),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: Arguments without the program name; ``sys.argv`` when None.

    Returns:
        The exit status of the process: 0, 1 or more if the command failed, 2 if it was wrong.
    """
    chosen, rest = _make_parser().parse_known_args(argv)
    if chosen.module is None:
        chosen.parser.print_help()
        return 0
    module = import_module(chosen.module)
    parser = argparse.ArgumentParser(prog=chosen.prog, description=f"{chosen.description}.")
    module.add_arguments(parser)
    args = parser.parse_args(rest)
    try:
        return int(module.main(args))
    except FeasigraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="feasigrasp", description="Feasible grasping of moving objects."
    )
    parser.add_argument("--version", action="version", version=f"feasigrasp {__version__}")
    parser.set_defaults(module=None, parser=parser)
    group_parsers = parser.add_subparsers(metavar="COMMAND")
    names = {}
    for group, purpose in GROUPS.items():
        group_parser = group_parsers.add_parser(group, help=purpose, description=f"{purpose}.")
        group_parser.set_defaults(parser=group_parser)
        names[group] = group_parser.add_subparsers(metavar="WHAT")
    for name, (module, purpose) in SINGLE_COMMANDS.items():
        group_parsers.add_parser(name, help=purpose, add_help=False).set_defaults(
            module=module, description=purpose, prog=f"feasigrasp {name}"
        )
    for (group, name), (module, purpose) in COMMANDS.items():
        # The options, --help included, are those of the module's own parser.
        names[group].add_parser(name, help=purpose, add_help=False).set_defaults(
            module=module, description=purpose, prog=f"feasigrasp {group} {name}"
        )
    return parser


if __name__ == "__main__":
    sys.exit(main())
