"""Compilation of the kernels of a run in advance, in parallel."""

from feasigrasp.warm_up.kernels import GROUPS, load_kernels
from feasigrasp.warm_up.warm_up import is_warm, warm_up

__all__ = ["GROUPS", "is_warm", "load_kernels", "warm_up"]
