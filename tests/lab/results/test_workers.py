"""Work in threads, in shards and on a cluster of processes."""

import argparse
import subprocess
import sys

import pytest

from feasigrasp_lab.results.workers import Shard, in_processes


def test_processes_do_every_task():
    tasks = [(n, 2) for n in range(7)]
    assert sorted(in_processes(pow, tasks, 2)) == [n**2 for n in range(7)]
    assert list(in_processes(pow, tasks, 2, ordered=True)) == [n**2 for n in range(7)]
    assert list(in_processes(pow, tasks, 1)) == [n**2 for n in range(7)]


def test_processes_end_with_a_command_that_is_killed():
    """Its error output closes when the last of them is gone."""
    code = """
import time
from feasigrasp_lab.results.workers import in_processes

for _ in in_processes(time.sleep, [(0.01,)] * 2 + [(0.5,)] * 1000, 2):
    print("one is done", flush=True)
"""
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, stdout=-1, stderr=-1, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    process.kill()
    assert "Traceback" not in process.communicate(timeout=60)[1]  # loky warns that it tidied up


def test_shards_are_read_and_named():
    shard = Shard.read("2/8")
    assert (shard.index, shard.count, str(shard)) == (2, 8, "2/8")
    assert shard.folder == "shard-2-of-8"
    for wrong in ("0/8", "9/8", "2", "2/0", "a/b", "-1/3"):
        with pytest.raises(argparse.ArgumentTypeError, match="give i/n"):
            Shard.read(wrong)
