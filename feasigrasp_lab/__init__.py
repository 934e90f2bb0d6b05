"""What measures feasigrasp, trains its networks and compares it with others; nothing that runs."""

from pathlib import Path

#: Where the trained weights of its parts are.
WEIGHTS = Path(__file__).resolve().parent / "weights"
