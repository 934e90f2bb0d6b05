"""Grasps: sampling, filtering, scoring, execution."""

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.grasps.perceive import Perception, perceive
from feasigrasp.models.grasps.samplers import SamplerName, make_sampler

__all__ = [
    "AntipodalSampler",
    "GraspSet",
    "NetworkSampler",
    "Perception",
    "Rejection",
    "SamplerName",
    "filter_grasps",
    "make_sampler",
    "perceive",
]
