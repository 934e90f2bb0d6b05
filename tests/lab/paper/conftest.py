"""What tests of the product use as well."""

from tests.models.conftest import ring_of_grasps
from tests.systems.conftest import ports

__all__ = ["ports", "ring_of_grasps"]
