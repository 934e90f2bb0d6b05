"""Errors of simulated sensors: depth camera, hand-eye calibration, joints. Estimators read none."""

from feasigrasp.models.sensors.camera_errors import MATERIALS, CameraErrors, Material
from feasigrasp.models.sensors.depth_noise import DepthNoise

__all__ = ["MATERIALS", "CameraErrors", "DepthNoise", "Material"]
