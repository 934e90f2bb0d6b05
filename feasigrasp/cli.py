"""The ``feasigrasp`` command: ``feasigrasp evaluate dynamic`` and so on.

A command is a module with ``add_arguments(parser)`` and ``main(args) -> int``; the first line of
its docstring says what it does. It is imported only when it is called. Other packages add commands
by an entry point (`feasigrasp.plugins`), as feasigrasp_lab adds ``evaluate``.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from feasigrasp import __version__
from feasigrasp.errors import FeasigraspError, needed_by
from feasigrasp.outputs import check_folder, only_one_in
from feasigrasp.plugins import load_plugin, plugins
from feasigrasp.runs.results.interrupts import STATUS, Unfinished

#: Options that Drake's own simulations spell with ``_``.
DRAKE_NAMES = ("--scenario_name", "--scenario_file", "--scenario_text")


class Commands(NamedTuple):
    """Commands that a package adds, as the entry point ``feasigrasp.commands`` names them.

    Attributes:
        groups: By group its purpose and its commands; a command is its module and its purpose.
        single: The commands without a group.
    """

    groups: dict[str, tuple[str, dict[str, tuple[str, str]]]]
    single: dict[str, tuple[str, str]]


def installed_commands() -> Commands:
    """Our commands and those of the packages that add some."""
    found = Commands({}, commands_in(Path(__file__).parent, "commands/*.py"))
    for name in plugins("commands"):
        added: Commands = load_plugin("commands", name)()
        found.groups.update(added.groups)
        found.single.update(added.single)
    return found


def commands_in(package: Path, pattern: str) -> dict[str, tuple[str, str]]:
    """The modules of a package that match a pattern, as commands; ``*`` is a command's name."""
    found = {}
    before = Path(pattern).stem.removesuffix("*")
    for file in sorted(package.glob(pattern), key=lambda file: file.stem):
        if file.stem != "__init__":
            module = ".".join(file.relative_to(package.parent).with_suffix("").parts)
            name = file.stem.removeprefix(before).replace("_", "-")
            found[name] = module, _purpose(file)
    return found


def _purpose(file: Path) -> str:
    """The first line of a module's docstring, behind the name of the command."""
    with file.open() as lines:
        return next(lines).partition(": ")[2].strip().strip('"').removesuffix(".")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line of ``argv``, or of the process when None.

    The exit status is 0, 1 or more if the command failed, 2 if it was wrong, 130 after Ctrl-C.
    """
    chosen, rest = _make_parser().parse_known_args(argv)
    if chosen.module is None:
        chosen.parser.print_help()
        return 0

    def run() -> int:
        with needed_by(f"'{chosen.prog}'"):
            module = import_module(chosen.module)
        parser = command_parser(chosen.prog, chosen.description)
        module.add_arguments(parser)
        args = parser.parse_args(rest)
        if "out" not in args:
            return int(module.main(args))
        if (shard := getattr(args, "shard", None)) is not None:
            args.out = args.out / shard.folder  # so that shards need not wait for each other
        check_folder("--out", args.out)
        try:
            with only_one_in(args.out):
                return int(module.main(args))
        except KeyboardInterrupt:
            message = "interrupted; the same command goes on from here"
            raise Unfinished(message, [], STATUS) from None

    return exit_status(run)


def command_parser(prog: str, purpose: str) -> argparse.ArgumentParser:
    """A parser whose ``--help`` shows defaults, and that reads options spelled with ``_``, too."""
    return _Parser(prog=prog, description=sentence(purpose))


class _Parser(argparse.ArgumentParser):
    """Reads ``--on_table`` as ``--on-table``, with a note on stderr unless it is Drake's name."""

    def __init__(self, *, add_help: bool = True, **given: Any) -> None:
        super().__init__(**given, formatter_class=_Help, add_help=False)
        if add_help:
            self.add_argument("-h", "--help", action="help", help="Show this help and exit.")

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        words = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args([self._with_hyphens(word) for word in words], namespace)

    def _get_value(self, action, arg_string):  # type: ignore[no-untyped-def]
        if action.type is Path and not arg_string:
            raise argparse.ArgumentError(action, "'' names no file or folder; give one")
        return super()._get_value(action, arg_string)

    def _with_hyphens(self, word: str) -> str:
        name, equals, value = word.partition("=")
        hyphenated = name.replace("_", "-")
        if hyphenated == name or hyphenated not in self._option_string_actions:
            return word
        if name not in DRAKE_NAMES:
            print(f"note: {name} is spelled {hyphenated}", file=sys.stderr)
        return hyphenated + equals + value


class _Help(argparse.HelpFormatter):
    """Adds the default of an option where its help does not state one."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text, default = super()._get_help_string(action) or "", action.default
        none = default is None or default is False or default is argparse.SUPPRESS
        if none or "Default:" in text or not action.option_strings:
            return text
        given = ",".join(map(str, default)) if isinstance(default, list) else str(default)
        return f"{text} Default: {given.replace('%', '%%')}."


def sentence(purpose: str) -> str:
    """The purpose of a command as a sentence."""
    return f"{purpose[:1].upper()}{purpose[1:]}."


def exit_status(work: Callable[[], int]) -> int:
    """Exit status of a command's process; errors are printed in one line.

    It is that of ``work``; 2 if something given was wrong; 130 after Ctrl-C.
    """
    try:
        return work()
    except Unfinished as error:
        print(error, file=sys.stderr)
        return error.status
    except FeasigraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return STATUS
    except BrokenPipeError:
        # Whoever read what is printed, such as `head`, has seen enough; nor can more be flushed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _make_parser() -> argparse.ArgumentParser:
    parser = command_parser("feasigrasp", "grasp moving objects with an arm, in simulation or real")
    version = f"feasigrasp {__version__}"
    parser.add_argument("--version", action="version", version=version, help="Show the version.")
    parser.set_defaults(module=None, parser=parser)
    group_parsers = parser.add_subparsers(metavar="COMMAND")

    def add(parsers: argparse._SubParsersAction, name: str, module: str, purpose: str) -> None:  # type: ignore[type-arg]
        # The options, --help included, are those of the module's own parser.
        command = parsers.add_parser(name, help=sentence(purpose), add_help=False)
        command.set_defaults(module=module, description=purpose, prog=command.prog)

    commands = installed_commands()
    for group, (purpose, members) in commands.groups.items():
        message = sentence(purpose)
        group_parser = group_parsers.add_parser(group, help=message, description=message)
        group_parser.set_defaults(parser=group_parser)
        names = group_parser.add_subparsers(metavar="WHAT")
        for name, (module, what) in members.items():
            add(names, name, module, what)
    for name, (module, what) in commands.single.items():
        add(group_parsers, name, module, what)
    return parser


if __name__ == "__main__":
    sys.exit(main())
