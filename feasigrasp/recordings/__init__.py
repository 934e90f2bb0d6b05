"""Depth images of real cameras: read from files, recorded into a folder."""

from feasigrasp.recordings.camera_file import CameraInfo, read_camera
from feasigrasp.recordings.folder import DepthFolder, read_depth_folder
from feasigrasp.recordings.images import captured_points, read_depth, read_mask
from feasigrasp.recordings.recorder import DepthFrame, recorded

__all__ = [
    "CameraInfo",
    "DepthFolder",
    "DepthFrame",
    "captured_points",
    "read_camera",
    "read_depth",
    "read_depth_folder",
    "read_mask",
    "recorded",
]
