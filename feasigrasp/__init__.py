"""feasigrasp: feasible grasping of moving objects, as Drake systems."""

__version__ = "0.1.0"
