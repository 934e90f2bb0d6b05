"""Objects: meshes, motions, pose filter and prediction."""

from feasigrasp.models.objects.motion import HarmonicMotion, ObjectMotion
from feasigrasp.models.objects.rigid_object import RigidObject, load_object

__all__ = ["HarmonicMotion", "ObjectMotion", "RigidObject", "load_object"]
