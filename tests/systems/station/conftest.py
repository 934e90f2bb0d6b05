"""Cells without and with a camera."""

import pytest

from tests.cell import Cell, scenario


@pytest.fixture(scope="session")
def blind():
    return Cell(scenario())


@pytest.fixture(scope="session")
def seeing():
    return Cell(scenario(cameras=True))
