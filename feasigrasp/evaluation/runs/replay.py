"""Records a simulation in Meshcat and writes it as one HTML file that plays offline."""

from __future__ import annotations

import logging
from pathlib import Path

from pydrake.geometry import Meshcat, MeshcatParams

#: Pictures per simulated second.
FRAMES_PER_SECOND = 32.0


def quiet_meshcat() -> Meshcat:
    """A Meshcat that neither opens a browser, nor needs a particular port, nor announces it."""
    drake_log = logging.getLogger("drake")
    level = drake_log.level
    drake_log.setLevel(logging.WARNING)  # do not announce an address that nobody needs
    try:
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0))
    finally:
        drake_log.setLevel(level)
    return meshcat


def start_recording() -> Meshcat:
    """A Meshcat that records."""
    meshcat = quiet_meshcat()
    meshcat.StartRecording(FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    return meshcat


def write_replay(meshcat: Meshcat, filename: Path) -> None:
    """Writes what was recorded as a self-contained HTML file."""
    meshcat.StopRecording()
    meshcat.PublishRecording()
    filename.parent.mkdir(parents=True, exist_ok=True)
    filename.write_text(meshcat.StaticHtml())
