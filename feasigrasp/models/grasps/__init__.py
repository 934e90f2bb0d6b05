"""Grasps: proposing, filtering, scoring, following through."""

from typing import TYPE_CHECKING

from feasigrasp.lazy import hand_on
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet

if TYPE_CHECKING:
    from feasigrasp.models.grasps.network_sampler import NetworkSampler
    from feasigrasp.models.grasps.perceive import perceive
    from feasigrasp.models.grasps.samplers import make_sampler

__all__ = [
    "AntipodalSampler",
    "GraspSet",
    "NetworkSampler",
    "filter_grasps",
    "make_sampler",
    "perceive",
]

__getattr__ = hand_on(
    __name__,
    {
        "NetworkSampler": "network_sampler",
        "make_sampler": "samplers",
        "perceive": "perceive",
    },
)
