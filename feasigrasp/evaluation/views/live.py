"""Watching a run while it goes on: Meshcat at real time, with a pause and a slider for speed."""

from __future__ import annotations

import threading
import time

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

#: Names of the controls, and the key that presses the button.
PAUSE, SPEED, KEY = "pause or go on", "speed [x real time]", "Space"
#: Speeds that the slider has; at the greatest the simulation is not held up.
SLOWEST, FASTEST, STEP = 0.1, 2.0, 0.1
#: Time between looks at the controls while it pauses [s].
_LOOK = 0.05


class LiveView:
    """A Meshcat with controls that a simulation heeds.

    Attributes:
        meshcat: Where to show the cell.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        """Adds the controls to a Meshcat; a browser may come at any time."""
        self.meshcat = meshcat
        self.meshcat.AddButton(PAUSE, KEY)
        self.meshcat.AddSlider(SPEED, SLOWEST, FASTEST, STEP, 1.0)
        self._speed = 0.0

    @property
    def paused(self) -> bool:
        """Whether the button was pressed an odd number of times."""
        return self.meshcat.GetButtonClicks(PAUSE) % 2 == 1

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
