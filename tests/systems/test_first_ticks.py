"""No kernel is compiled, or fetched from the cache, inside a control tick of the whole diagram."""

import subprocess
import sys

import pytest

SCRIPT = """
import sys
from numba.core.dispatcher import Dispatcher
from pydrake.systems.analysis import Simulator
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp

file = diagram_path("dynamic.scenarios.yaml")
scenario = load_scenario(file, "ReachObstacleMocap", f"{{control: {{controller: {sys.argv[1]}}}}}")
diagram = make_dynamic_grasp(scenario)
controller, ticks, compiled = diagram.GetSubsystemByName("controller"), [], []
compile = Dispatcher.compile
for name in ("update", "velocity"):
    def timed(*args, method=getattr(controller, name), name=name):
        ticks.append(name)
        counted = lambda self, sig: (compiled.append(self.py_func.__name__), compile(self, sig))[1]
        Dispatcher.compile = counted
        try:
            return method(*args)
        finally:
            Dispatcher.compile = compile
    setattr(controller, name, timed)
Simulator(diagram).AdvanceTo(1.5)
print(ticks.count("update"), ticks.count("velocity"), *compiled)
"""


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_no_kernel_is_compiled_inside_a_tick(controller):
    """In a process of its own: what other tests have run is compiled already."""
    command = [sys.executable, "-c", SCRIPT, controller]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["75", "300"]
