"""Point clouds: reading, checks, fusion of views."""

from feasigrasp.models.clouds.files import prepare_cloud, read_cloud
from feasigrasp.models.clouds.fusion import FusedCloud

__all__ = ["FusedCloud", "prepare_cloud", "read_cloud"]
