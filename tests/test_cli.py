"""The ``feasigrasp`` command: what it offers, and how it says no."""

import argparse
import importlib
import re
import subprocess
import sys

import pytest

from feasigrasp import __version__, cli
from feasigrasp.errors import ScenarioError

GROUPS, SINGLE = cli.installed_commands()
COMMANDS = [(group, name) for group, (_, found) in GROUPS.items() for name in found]
ALL = [*COMMANDS, *((name,) for name in SINGLE)]


def found(*command):
    """Module and purpose of a command."""
    *group, name = command
    return (GROUPS[group[0]][1] if group else SINGLE)[name]


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"feasigrasp {__version__}\n"


@pytest.mark.parametrize("argv", [[], ["evaluate"]])
def test_without_a_command_it_lists_them(argv, capsys):
    assert cli.main(argv) == 0
    assert ("dynamic" if argv else "evaluate") in capsys.readouterr().out


def test_every_command_has_its_own_help(capsys):
    for command in ALL:
        with pytest.raises(SystemExit) as ended:
            cli.main([*command, "--help"])
        assert ended.value.code == 0
        out = capsys.readouterr().out
        assert f"feasigrasp {' '.join(command)}" in out
        # Seeds and objects of all measurements are those of their list.
        if command[0] in ("evaluate", "bench") and command != ("evaluate", "all"):
            for option in ("--out", "--seed", "--jobs", "--objects", "--quick"):
                assert option in out, command


def test_every_command_is_a_module_that_says_what_it_does():
    for command in ALL:
        module_name, purpose = found(*command)
        module = importlib.import_module(module_name)
        assert callable(module.main) and callable(module.add_arguments)
        if command != ("report",):
            said = f"``feasigrasp {' '.join(command)}``: {purpose}."
            assert module.__doc__.splitlines()[0] == said


def test_the_commands_are_those_that_users_rely_on():
    assert {group: list(commands) for group, (_, commands) in GROUPS.items()} == {
        "evaluate": [
            *("all", "dynamic", "faults", "gallery", "hardware-loop", "kinematics", "reachability"),
            *("sampler", "segmentation", "shape", "static", "tracking"),
        ],
        "bench": ["all", "control", "kinematics", "reachability", "sampler", "shape"],
        "fit": ["certainty", "reachability"],
        "train": ["diffusion", "hidden-side", "ik-flow", "sampler", "sampler-data"],
    }


def test_the_commands_for_people_are_there():
    assert list(SINGLE) == [
        *("arm", "doctor", "driver", "feasible", "guard", "live", "objects", "perceive", "record"),
        "run",
        *("scenarios", "sim", "track", "warm-up"),
        "report",
    ]


def parsers():
    """The parsers of all commands."""
    for command in ALL:
        parser = cli.command_parser(" ".join(command), "test")
        importlib.import_module(found(*command)[0]).add_arguments(parser)
        yield parser


def test_options_are_spelled_with_hyphens():
    for parser in parsers():
        assert not [option for option in parser._option_string_actions if "_" in option]


def test_options_show_their_defaults():
    for parser in parsers():
        shown = parser._get_formatter()
        for action in parser._actions:
            if not any(action.default is none for none in (None, False, argparse.SUPPRESS)):
                assert action.help and "Default: " in shown._expand_help(action), action.dest


def is_sentence(text):
    """Whether a text begins with a capital or a quoted word, and ends with a full stop."""
    return re.fullmatch(r"[A-Z'][^\n]+[^.]\.", text) is not None


def test_help_is_made_of_sentences():
    for parser in parsers():
        shown = parser._get_formatter()
        for action in parser._actions:
            text = shown._expand_help(action) if action.help else ""
            former = text == argparse.SUPPRESS  # a name that goes with the next release
            assert former or is_sentence(text), (parser.prog, action.dest, text)


def test_the_list_of_commands_is_made_of_sentences():
    assert not is_sentence("folder of the results") and not is_sentence("Folder")
    purposes = [what for what, _ in GROUPS.values()]
    for commands in (*(commands for _, commands in GROUPS.values()), SINGLE):
        purposes += [what for _, what in commands.values()]
    assert all(map(is_sentence, map(cli.sentence, purposes)))


def test_a_default_is_shown_once_and_as_it_is_given():
    parser = cli.command_parser("test", "test")
    parser.add_argument("--names", default=["a", "b"], help="Some.")
    parser.add_argument("--seed", type=int, default=0, help="A number.")
    parser.add_argument("--share", default="5%", help="A share.")
    parser.add_argument("--said", default="x", help="This. Default: see there.")
    parser.add_argument("--flag", action="store_true", help="A flag.")
    parser.add_argument("--file", help="A file.")
    said = " ".join(parser.format_help().split())
    for text in ("Some. Default: a,b.", "A number. Default: 0.", "A share. Default: 5%."):
        assert text in said
    assert said.count("Default:") == 4 and "see there" in said


@pytest.mark.parametrize(
    ("option", "note"),
    [
        ("--end_frame", "note: --end_frame is spelled --end-frame\n"),
        ("--end-frame", ""),
        ("--scenario_text", ""),  # Drake's name
    ],
)
@pytest.mark.parametrize("assigned", [False, True])
def test_an_option_may_be_spelled_with_underscores(option, note, assigned, capsys):
    parser = cli.command_parser("test", "test")
    for name in ("--end-frame", "--scenario-text"):
        parser.add_argument(name, dest="value")
    words = [f"{option}=a_b"] if assigned else [option, "a_b"]
    assert parser.parse_args(words).value == "a_b"
    assert capsys.readouterr().err == note


def test_a_word_that_is_no_option_is_read_as_it_is(capsys):
    parser = cli.command_parser("test", "test")
    parser.add_argument("names", nargs="*")
    assert parser.parse_args(["--", "--my_file"]).names == ["--my_file"]
    with pytest.raises(SystemExit):
        parser.parse_args(["--my_file"])
    assert "unrecognized arguments: --my_file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["evaluat"], "invalid choice: 'evaluat'"),
        (["evaluate", "everything"], "invalid choice: 'everything'"),
        (["evaluate", "dynamic", "--sedes", "2"], "unrecognized arguments: --sedes 2"),
        (["evaluate", "dynamic", "--seeds", "0"], "0 is less than 1"),
        (["evaluate", "dynamic", "--jobs", "two"], "invalid positive value: 'two'"),
        (["evaluate", "dynamic", "--study", "brave"], "invalid choice: 'brave'"),
        (["report"], "the following arguments are required: DIR"),
        (["evaluate", "dynamic", "--scenarios", ","], "no name given"),
    ],
)
def test_wrong_arguments_are_named(argv, message, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(argv)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenarios", "ReachSquare"], "no scenario 'ReachSquare'"),
        (["--controllers", "magic"], "control.controller is 'magic'"),
        (["--mode", "safe,brave"], "control.mode is 'brave'"),
        (["--objects", "teapot"], "'teapot' is neither a built-in object"),
        (["--scenario-text", "{objct: {}}"], "objct"),
        (["--seed", "-3"], "random_seed is -3"),
    ],
)
def test_wrong_plans_end_before_the_first_run(arguments, message, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["evaluate", "dynamic", "--out", str(out), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_errors_of_the_project_become_a_message(monkeypatch, capsys):
    module = importlib.import_module("feasigrasp_lab.studies.dynamic")

    def fail(args):
        raise ScenarioError("no such thing; take another")

    monkeypatch.setattr(module, "main", fail)
    assert cli.main(["evaluate", "dynamic"]) == 2
    assert capsys.readouterr().err == "error: no such thing; take another\n"


def test_an_interruption_has_a_status_of_its_own(monkeypatch, capsys):
    module = importlib.import_module("feasigrasp_lab.studies.dynamic")

    def interrupted(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "main", interrupted)
    assert cli.main(["evaluate", "dynamic"]) == 130
    assert "the same command goes on from here" in capsys.readouterr().err


def test_a_run_that_is_interrupted_does_not_go_on(monkeypatch, capsys):
    module = importlib.import_module("feasigrasp.commands.objects")

    def interrupted(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "main", interrupted)
    assert cli.main(["objects"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_help_is_quick_because_nothing_heavy_is_imported():
    program = (
        "import sys; from feasigrasp.cli import main; main([]);"
        "sys.exit('pydrake' in sys.modules or 'torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True).returncode == 0
