"""A diagram that is let go is freed, with plant, renderers and meshes: 40 MB each."""

import gc
import weakref

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.resources import diagram_path
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import make_dynamic_grasp


class Nothing(LeafSystem):
    """A system without ports."""

    def __init__(self):
        super().__init__()


def is_freed(make):
    """Whether what a function makes is freed once nobody holds it."""
    made = weakref.ref(make())
    for _ in range(2):
        gc.collect()
    return made() is None


def smallest():
    builder = DiagramBuilder()
    builder.AddSystem(Nothing())
    return builder.Build()


@pytest.mark.parametrize("name", ["ReachLinearMocap", "ReachObstacle"])
def test_a_diagram_is_freed(name):
    if not is_freed(smallest):
        pytest.skip("this Drake frees no diagram with a system in Python (1.51 on Python 3.11)")
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), name)
    assert is_freed(lambda: make_dynamic_grasp(scenario))
