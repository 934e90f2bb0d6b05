"""What tests of systems share."""

from tests.systems.conftest import ports  # noqa: F401
