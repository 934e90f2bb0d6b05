"""The command that runs every measurement of the tables, without running any."""

import argparse
import shlex
import subprocess
from importlib import import_module

import pytest

from feasigrasp import cli
from feasigrasp_lab.studies import all as study


@pytest.fixture
def commands(monkeypatch):
    """What is called, instead of calling it; a measurement writes its summary."""
    called = []

    def run(words):
        called.append(words)
        folder = study.Path(words[words.index("--out") + 1])
        folder.mkdir(parents=True)
        (folder / "summary.json").write_text("{}")
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(study.subprocess, "run", run)
    monkeypatch.setattr(study, "git_revision", lambda: "0123456789ab")
    return called


def names(called, out):
    return [
        study.Path(words[words.index("--out") + 1]).relative_to(out).as_posix() for words in called
    ]


@pytest.mark.parametrize(("name", "measurement"), study.measurements().items())
def test_every_command_is_one_that_there_is(name, measurement):
    group, command, *options = shlex.split(measurement.command)
    module = import_module(cli.installed_commands().groups[group][1][command][0])
    parser = cli.command_parser(name, "")
    module.add_arguments(parser)
    args = parser.parse_args([*options, "--out", "OUT", "--jobs", "2", "--quick"])
    assert args.quick
    assert not {"seed", "objects"} & {*vars(args)} or 0 <= (args.seed or 0) < 600


def test_what_is_finished_is_not_run_again(commands, tmp_path, capsys):
    every = [*study.measurements()]
    assert cli.main(["evaluate", "all", "--out", str(tmp_path), "--only", ",".join(every[:2])]) == 0
    assert names(commands, tmp_path) == every[:2]
    cli.main(["evaluate", "all", "--out", str(tmp_path), "--only", ",".join(every[:3])])
    assert names(commands, tmp_path) == every[:3]
    assert "2 of 3 are finished" in capsys.readouterr().out


def test_shards_share_all_of_them(commands, tmp_path):
    for shard in ("1/3", "2/3", "3/3"):
        cli.main(["evaluate", "all", "--out", str(tmp_path), "--shard", shard])
    found = [name.partition("/")[2] for name in names(commands, tmp_path)]
    assert sorted(found) == sorted(study.measurements())


def test_the_sample_is_some_of_them(commands, tmp_path):
    cli.main(["evaluate", "all", "--out", str(tmp_path), "--quick"])
    assert 0 < len(commands) < len(study.measurements())
    assert all("--quick" in words for words in commands)


@pytest.mark.parametrize("revision", ["ba9876543210", "0123456789ab-dirty", None])
def test_revisions_are_not_mixed(commands, tmp_path, monkeypatch, capsys, revision):
    one = next(iter(study.measurements()))
    cli.main(["evaluate", "all", "--out", str(tmp_path), "--only", one])
    monkeypatch.setattr(study, "git_revision", lambda: revision)
    assert cli.main(["evaluate", "all", "--out", str(tmp_path), "--only", one]) == 2
    assert "revision" in capsys.readouterr().err
    assert len(commands) == 1


def test_an_unknown_name_is_named(commands, tmp_path, capsys):
    assert cli.main(["evaluate", "all", "--out", str(tmp_path), "--only", "dynamic_rech"]) != 0
    assert "dynamic_reach" in capsys.readouterr().err


def test_the_data_folder_is_that_of_the_argument(tmp_path):
    args = argparse.Namespace(data=tmp_path, out=tmp_path, jobs=2, quick=False)
    words = study.command_of("x", study.Measurement("evaluate shape --objects DATA/ycb", 1.0), args)
    assert f"{tmp_path}/ycb" in words
