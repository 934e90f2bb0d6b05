"""Watching a run while it goes on: at real time, with a pause and a slider for speed."""

from __future__ import annotations

import select
import sys
import threading
import time
from collections.abc import Callable

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from feasigrasp.runs.live_server import LiveServer

#: Names of the controls, and the key that presses the button.
PAUSE, SPEED, KEY = "pause or go on", "speed [x real time]", "Space"
#: Speeds that the slider has; at the greatest the simulation is not held up.
SLOWEST, FASTEST, STEP = 0.1, 2.0, 0.1
#: Time between looks at the controls, the browser and the keyboard while it waits [s].
_LOOK = 0.05


class LiveView:
    """A page with Meshcat, legend, status and camera picture, and controls of the simulation.

    Attributes:
        meshcat: Where to show the cell.
        server: Serves the page, and sets what it shows beside the cell.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        """Adds the controls to a Meshcat; a browser may come at any time."""
        self.meshcat = meshcat
        self.meshcat.AddButton(PAUSE, KEY)
        self.meshcat.AddSlider(SPEED, SLOWEST, FASTEST, STEP, 1.0)
        self.server = LiveServer(meshcat.port())
        self._speed = 0.0

    @property
    def paused(self) -> bool:
        """Whether the button was pressed an odd number of times."""
        return self.meshcat.GetButtonClicks(PAUSE) % 2 == 1

    def wait_for_browser(self, interrupted: threading.Event) -> None:
        """Waits until a browser shows the page, or somebody presses Enter.

        Args:
            interrupted: What ends the wait, too.
        """
        _wait(lambda: self.meshcat.GetNumActiveConnections() > 0 or interrupted.is_set())

    def stay(self) -> None:
        """Serves the page until somebody presses Enter or Ctrl-C."""
        print(f"{self.server.url} stays open; Enter or Ctrl-C ends it", flush=True)
        try:
            _wait(lambda: False)
        except KeyboardInterrupt:
            print()  # behind the terminal's ^C

    def pace(self, simulator: Simulator, interrupted: threading.Event) -> None:
        """Runs a simulator as fast as the slider says, and waits while it is to pause.

        Args:
            simulator: At a step of its.
            interrupted: What ends a pause, beside the button.
        """
        waited = False
        while self.paused and not interrupted.is_set():
            waited = True
            time.sleep(_LOOK)
        speed = self.meshcat.GetSliderValue(SPEED)
        if waited or speed != self._speed:
            self._speed = speed
            simulator.set_target_realtime_rate(speed if speed < FASTEST else 0.0)
            simulator.ResetStatistics()  # from here on: what is behind is not caught up


def _wait(over: Callable[[], bool]) -> None:
    """Waits until something is over, or a line or the end of the standard input is read."""
    while not over():
        try:
            readable = select.select([sys.stdin], [], [], _LOOK)[0]
        except (OSError, ValueError):  # there is no standard input
            return
        if readable:
            sys.stdin.readline()
            return
