"""The page of a run that goes on: it waits for a browser, shows the state, and stays at the end."""

import base64
import json
import os
import re
import socket
import sys
import threading
import urllib.error
import urllib.request

import pytest

from feasigrasp import cli
from feasigrasp.models.control.status import Status, StatusCode
from feasigrasp.runs.console import verdict
from feasigrasp.runs.live import LiveView
from feasigrasp.runs.replay import FRAMES_PER_SECOND, quiet_meshcat
from feasigrasp.runs.run import run
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.monitoring.camera_pictures import Picture
from tests.browser import visit

SLIPS = Status(1.5, StatusCode.SLIPPING, "moved <7 mm> in the hand")


@pytest.fixture
def live():
    return LiveView(quiet_meshcat())


@pytest.fixture
def keyboard(monkeypatch):
    """A file: what is written to it is typed."""
    reading, writing = os.pipe()
    with open(reading) as typed, open(writing, "w") as keys:
        monkeypatch.setattr(sys, "stdin", typed)
        yield keys


def wait_until(live, act, interrupted=None):
    """Waits for a browser in this thread, as Meshcat asks, while another acts after a while."""
    acted = threading.Event()

    def later():
        acted.set()
        act()

    timer = threading.Timer(0.3, later)
    timer.start()
    live.wait_for_browser(interrupted or threading.Event())
    assert acted.is_set()
    timer.join()


def test_the_run_waits_for_a_browser(live, keyboard):
    port = live.meshcat.port()
    with socket.socket() as browser:

        def connect():
            browser.connect(("localhost", port))
            key = base64.b64encode(bytes(16)).decode()
            lines = ["GET / HTTP/1.1", "Host: localhost", "Upgrade: websocket"]
            lines += ["Connection: Upgrade", "Sec-WebSocket-Version: 13"]
            lines += [f"Sec-WebSocket-Key: {key}", "", ""]
            browser.sendall("\r\n".join(lines).encode())

        wait_until(live, connect)


@pytest.mark.parametrize("how", ["Enter", "end of the input", "Ctrl-C"])
def test_it_goes_on_without_a_browser(how, live, keyboard):
    interrupted = threading.Event()
    acts = {
        "Enter": lambda: print(file=keyboard, flush=True),
        "end of the input": keyboard.close,
        "Ctrl-C": interrupted.set,
    }
    wait_until(live, acts[how], interrupted)


def test_the_page_stays_until_enter_and_says_so(live, keyboard, capsys):
    thread = threading.Thread(target=live.stay, daemon=True)
    thread.start()
    thread.join(0.3)
    assert thread.is_alive() and fetch(live, "").startswith("<!DOCTYPE html>")
    print(file=keyboard, flush=True)
    thread.join(10.0)
    assert not thread.is_alive()
    assert capsys.readouterr().out == f"{live.url} stays open; Enter or Ctrl-C ends it\n"


def test_ctrl_c_ends_the_stay_without_a_traceback(live, keyboard, monkeypatch):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr("select.select", interrupted)
    live.stay()


def fetch(live, path):
    with urllib.request.urlopen(live.url + path) as answer:
        return answer.read().decode()


def test_the_server_has_the_page_and_the_latest_state(live):
    assert f":{live.meshcat.port()}/" in fetch(live, "")
    assert json.loads(fetch(live, "state")) == {"time": 0.0, "status": None, "picture": None}
    live.show(2.0, SLIPS, Picture(1.75, b"jpeg"))
    state = json.loads(fetch(live, "state"))
    assert state["time"] == 2.0 and state["status"] == ["slipping", SLIPS.detail]
    assert base64.b64decode(state["picture"]) == b"jpeg"
    with pytest.raises(urllib.error.HTTPError, match="404"):
        fetch(live, "pyproject.toml")


def test_page_and_replay_say_in_the_end_what_came_out(live, keyboard, tmp_path):
    keyboard.close()  # nobody waits for a browser
    scenario = load_scenario("Static", "{random_seed: 3, simulation_duration: 0.8}")
    result = run(scenario, live=live, replay=tmp_path / "replay.html")
    words = verdict(result.record)
    assert words.startswith("not held: ")
    assert json.loads(fetch(live, "state"))["status"] == ["done", words]
    page = (tmp_path / "replay.html").read_text()
    (line,) = re.findall(r"const statuses = (.*);", page)
    *before, (last, *said) = json.loads(line)
    assert said == ["done", words]
    # While the last picture is shown: what is recorded ends with it.
    assert before[-1][0] <= last <= 0.8 - 1.0 / FRAMES_PER_SECOND + 1e-9


def test_a_browser_shows_legend_status_and_picture(live, tmp_path):
    live.show(2.0, SLIPS, Picture(1.75, b"jpeg"))
    _, page = visit(live.url, tmp_path, seconds=3.0)
    assert "2.0 s: slipping (moved &lt;7 mm&gt; in the hand)" in page
    assert f"data:image/jpeg;base64,{base64.b64encode(b'jpeg').decode()}" in page
    assert "reachable grasps" in page
    assert f'src="http://localhost:{live.meshcat.port()}/"' in page


def test_a_run_without_keyboard_or_browser_comes_to_its_end(monkeypatch, capsys):
    shown = []
    monkeypatch.setattr(
        "feasigrasp.runs.live.LiveView.show",
        lambda view, time, status, picture: shown.append((time, status, picture)),
    )
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert cli.main(["run", "ReachLinearMocap", "--duration", "1.0", "--live"]) == 0
    out = capsys.readouterr().out
    address = out.split()[1]
    assert out.startswith(f"open {address} in a browser")
    assert out.endswith(f"{address} stays open; Enter or Ctrl-C ends it\n")
    last, status, picture = shown[-1]
    assert last > 0.2 and picture.time <= last and picture.jpeg
    assert status.code in StatusCode and status.time <= last
