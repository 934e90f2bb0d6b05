"""Point clouds: reading, checks, fusion of views, sensor noise."""

from feasigrasp.models.clouds.depth_noise import DepthNoise
from feasigrasp.models.clouds.files import prepare_cloud, read_cloud
from feasigrasp.models.clouds.fusion import FusedCloud

__all__ = ["DepthNoise", "FusedCloud", "prepare_cloud", "read_cloud"]
