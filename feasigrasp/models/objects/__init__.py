"""Objects: their meshes, motions, and where they will be."""

from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.rigid_object import RigidObject, load_object

__all__ = ["HarmonicMotion", "RigidObject", "load_object"]
