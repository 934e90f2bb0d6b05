"""Work in threads, in shards and on a cluster of processes."""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from feasigrasp_lab.results.workers import ClusterError, Shard, in_processes, in_threads, on_cluster


def test_threads_do_every_task():
    tasks = {str(n): (n, 2) for n in range(7)}
    assert dict(in_threads(pow, tasks, 3)) == {str(n): n**2 for n in range(7)}


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


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"feasigrasp\[cluster\]"):
        list(on_cluster(pow, {"a": (1, 2)}, "tcp://localhost:1"))


def slow_square(number, folder):
    """Says who does it, and takes a moment."""
    with (Path(folder) / str(number)).open("a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(0.2)
    if number < 0:
        raise ValueError(f"{number} is negative")
    return number**2


@pytest.fixture(scope="module")
def make_cluster():
    """Makes clusters of processes that may start others, or may not."""
    distributed = pytest.importorskip("distributed", reason="needs the cluster extra")
    import cloudpickle
    import dask

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    made = []

    def make(count, *, daemon=False):
        with dask.config.set({"distributed.worker.daemon": daemon}):
            local = distributed.LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
            )
        made.append(local)
        return local.scheduler_address

    yield make
    for local in made:
        local.close()
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


@pytest.fixture(scope="module")
def cluster(make_cluster):
    """Of two processes that may start others."""
    return make_cluster(2)


def test_a_cluster_does_every_task_and_tells_which_failed(cluster, tmp_path):
    tasks = {f"task {n}": (n, str(tmp_path)) for n in range(-1, 5)}
    done = dict(on_cluster(slow_square, tasks, cluster))
    failed = done.pop("task -1")
    assert isinstance(failed, ValueError) and "is negative" in str(failed)
    assert done == {f"task {n}": n**2 for n in range(5)}
    who = {file.read_text() for file in tmp_path.iterdir()}
    assert f"{os.getpid()}\n" not in who


def test_a_killed_worker_loses_nothing(cluster, tmp_path):
    tasks = {str(n): (n, str(tmp_path)) for n in range(8)}
    found = on_cluster(slow_square, tasks, cluster)
    done = dict([next(found)])
    victim = int((tmp_path / next(iter(done))).read_text())
    os.kill(victim, signal.SIGKILL)
    done |= dict(found)
    assert done == {str(n): n**2 for n in range(8)}


def test_daemonic_workers_are_refused_with_the_mend(make_cluster, tmp_path):
    with pytest.raises(ClusterError, match="--no-nanny"):
        tasks = {"1": (1, str(tmp_path))}
        list(on_cluster(slow_square, tasks, make_cluster(1, daemon=True)))
