"""A stage in a process of its own: what it tells, when, and what happens without the process."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.errors import WorkerError
from feasigrasp.systems.remote import worker
from feasigrasp.systems.remote.remote_stage import RemoteStage, end_processes
from feasigrasp.systems.remote.worker import Worker
from tests.remote_counter import DIE, NAP, PERIOD, SLEEP, Counter, Sentence, broken, fixed


class Run:
    """A stage in a simulator, by its ports."""

    def __init__(self, stage, **inputs):
        self.stage, self.simulator = stage, Simulator(stage)
        self.context = self.simulator.get_mutable_context()
        fixed(stage, self.context, **inputs)

    def to(self, instant):
        self.simulator.AdvanceTo(instant)
        self.simulator.AdvancePendingEvents()
        return self["grasps"]

    def __getitem__(self, port):
        return self.stage.GetOutputPort(port).Eval(self.context)


@pytest.fixture
def free():
    """A stage that nobody waits for."""
    stage = RemoteStage(Counter, PERIOD)
    stage.worker.wait_until_ready()
    yield Run(stage, number=2.0, word="a")
    stage.worker.close()


def taken(run, instant, patience=30.0):
    """Takes until something has arrived."""
    deadline = time.monotonic() + patience
    while not (latencies := run.stage.take(run.context, instant)):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    return latencies


def test_in_lock_step_it_tells_what_the_stage_itself_would_and_as_late_as_it_should():
    inline = Run(Counter(), number=2.0, word="a")
    remote = Run(RemoteStage(Counter, PERIOD, latency=0.04), number=2.0, word="a")
    for k in range(4):
        fixed(inline.stage, inline.context, number=float(k))
        fixed(remote.stage, remote.context, number=float(k))
        before = inline["grasps"]
        expected = inline.to(k * PERIOD)
        assert remote.to(k * PERIOD) == before  # posted, not there
        fixed(remote.stage, remote.context, number=7.0)  # after the view
        assert remote.to(k * PERIOD + 0.05) == expected
        assert remote["total"] == inline["total"]
    assert len(expected) == 4


def test_results_may_be_later_than_the_next_view():
    remote = Run(RemoteStage(Counter, PERIOD, latency=0.25), number=1.0)
    counts = [len(remote.to(instant)) for instant in (0.24, 0.26, 0.34, 0.36, 0.46)]
    assert counts == [0, 1, 1, 2, 3]


def test_nobody_waits_and_the_latest_wins(free):
    fixed(free.stage, free.context, number=SLEEP)
    began = time.monotonic()
    assert free.to(3 * PERIOD) == ()
    assert time.monotonic() - began < 0.5 * NAP
    assert taken(free, 5.0) == [5.0]  # one result, of the view at 0: the others were passed over
    assert [at for at, _, _ in free["grasps"]] == [0.0]
    fixed(free.stage, free.context, number=3.0)
    free.to(4 * PERIOD)
    assert taken(free, 5.0) == pytest.approx([4.6])
    assert [at for at, _, _ in free["grasps"]] == pytest.approx([0.0, 0.4])


def test_latency_counts_from_the_image_and_no_image_is_posted_twice(free):
    fixed(free.stage, free.context, stamp=-0.03)
    free.to(0.0)
    assert not free.stage.worker.busy
    fixed(free.stage, free.context, stamp=0.07)
    free.to(0.1)
    assert taken(free, 0.2) == pytest.approx([0.13])
    free.to(0.3)
    time.sleep(0.3)
    assert free.stage.take(free.context, 0.3) == [] and len(free["grasps"]) == 1
    fixed(free.stage, free.context, stamp=np.nan)
    free.to(0.4)
    assert not free.stage.worker.busy
    fixed(free.stage, free.context, stamp=0.35)
    free.to(0.5)
    assert taken(free, 0.6) == pytest.approx([0.25])


def lapse(run):
    """Lets time pass until the process is missed, then until there is another one."""
    instant, deadline, before = 1.0, time.monotonic() + 60.0, run["grasps"]
    for lapsed in (1.0, 0.0):
        while run["lapsed"][0] != lapsed:
            assert time.monotonic() < deadline and run["grasps"] == before
            if lapsed:
                run.to(instant)  # posts
            run.stage.take(run.context, instant)
            instant += PERIOD
            time.sleep(0.02)
    return before, instant


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_is_gone_or_hangs_is_missed_and_another_one_goes_on_from_there(
    free, number, monkeypatch
):
    monkeypatch.setattr(worker, "PATIENCE", 0.5)
    free.to(0.0)
    taken(free, 0.1)
    pid = free.stage.worker.pid
    os.kill(pid, number)
    before, instant = lapse(free)
    assert [entry[1:] for entry in before] == [(2.0, "a")]
    assert free.stage.worker.pid != pid
    free.to(instant)
    taken(free, instant)
    assert len(free["grasps"]) == 2 and free["grasps"][:1] == before


def test_what_nobody_changes_is_posted_once_to_every_process(free, monkeypatch):
    posted, post = [], free.stage.worker.post
    monkeypatch.setattr(
        free.stage.worker, "post", lambda at, given: (posted.append(set(given)), post(at, given))
    )
    fixed(free.stage, free.context, word=Sentence("b"))
    for instant in (0.0, 0.1):
        free.to(instant)
        taken(free, instant + 0.05)
    fixed(free.stage, free.context, word=Sentence("c"))
    free.to(0.2)
    taken(free, 0.25)
    assert posted == [{"number", "word"}, {"number"}, {"number", "word"}]
    os.kill(free.stage.worker.pid, signal.SIGKILL)
    _, instant = lapse(free)
    free.to(instant)
    taken(free, instant)
    assert free["grasps"][-1][2] == "c"


def test_in_lock_step_a_process_that_dies_ends_the_simulation():
    remote = Run(RemoteStage(Counter, PERIOD, latency=0.04), number=DIE)
    with pytest.raises(WorkerError, match="inline"):
        remote.to(0.05)


def test_one_that_cannot_be_built_is_not_waited_for():
    with pytest.raises(WorkerError, match="does not start"):
        Worker(broken).wait_until_ready()


@pytest.mark.parametrize("stopped", [False, True])
def test_processes_can_be_ended(stopped):
    builder = DiagramBuilder()
    stage = builder.AddSystem(RemoteStage(Counter, PERIOD))
    diagram = builder.Build()
    stage.worker.wait_until_ready()
    if stopped:
        os.kill(stage.worker.pid, signal.SIGSTOP)
    end_processes(diagram)
    with pytest.raises(ProcessLookupError):
        os.kill(stage.worker.pid, 0)


def test_a_process_ends_when_the_one_that_it_works_for_is_killed():
    code = (
        "import time; from tests.remote_counter import Counter; "
        "from feasigrasp.systems.remote.worker import Worker; "
        "worker = Worker(Counter); worker.wait_until_ready(); print(worker.pid, flush=True); "
        "time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        pid = int(parent.stdout.readline())
        os.kill(pid, 0)
        parent.kill()
    deadline = time.monotonic() + 10.0
    while Path(f"/proc/{pid}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_without_a_new_image_nothing_is_waited_for():
    """The first image of a camera may come late; results are as late as ever after it."""
    remote = Run(RemoteStage(Counter, PERIOD, latency=0.25), number=1.0, stamp=np.nan)
    assert remote.to(0.36) == ()
    fixed(remote.stage, remote.context, stamp=0.35)  # posted at 0.4
    assert [len(remote.to(instant)) for instant in (0.64, 0.66, 0.95)] == [0, 1, 1]
