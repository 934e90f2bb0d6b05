"""Parts of one's own that a scenario names."""

import textwrap
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.cli import main
from feasigrasp.errors import ScenarioError
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.parts import Part, load_part
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.object_tracker import ObjectTracker

FILE = diagram_path("dynamic.scenarios.yaml")
MODULE = """
import numpy as np
from feasigrasp.models.objects import ObjectMotion
from feasigrasp.models.grasps import AntipodalSampler
from feasigrasp.systems.object_tracker import ObjectTracker

class Few:
    def __init__(self, gripper, most=20):
        self._gripper, self._most = gripper, most
    def __call__(self, gpdf):
        grasps = AntipodalSampler(self._gripper)(gpdf)
        return grasps.select(range(min(self._most, len(grasps))), "too many")

class Own(ObjectTracker):
    pass

class Higher(ObjectMotion):
    def __init__(self, path, height=0.1):
        self._path, self._height = path, height
    def state(self, t):
        X_WO, V_WO, a_WO = (np.array(part) for part in self._path.state(t))
        X_WO[2, 3] += self._height
        return X_WO, V_WO, a_WO

class Wrong(Higher):
    def state(self, t):
        return super().state(t)[:2]

number = 3
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A file in the folder that a command runs in."""
    (tmp_path / "my_parts.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # and taken off the path afterwards


def loaded(text):
    return load_scenario(FILE, "ReachLinearMocap", f"{{parts: {text}}}")


def test_a_named_sampler_and_tracker_run_in_the_diagram(module):
    scenario = loaded(
        "{sampler: {name: 'my_parts:Few', options: {most: 3}}, tracker: {name: 'my_parts:Own'}}"
    )
    scenario = parse_scenario(dump_scenario(scenario))  # as in a record, and back
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.6)
    sampler = diagram.subsystems.sampler
    grasps = sampler.get_output_port().Eval(sampler.GetMyContextFromRoot(simulator.get_context()))
    assert len(grasps) == 3
    assert type(diagram.subsystems.tracker).__name__ == "Own"
    assert isinstance(diagram.subsystems.tracker, ObjectTracker)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "{sampler: {name: 'nowhere:Few'}}",
            "parts.sampler.name: 'nowhere:Few' cannot be imported",
        ),
        ("{sampler: {name: 'my_parts:Fev'}}", "my_parts has no such class; do you mean Few"),
        ("{sampler: {name: 'my_parts:number'}}", "my_parts has no such class"),
        ("{sampler: {name: my_parts}}", "not of the form package.module:Name"),
        ("{sampler: {name: '.my_parts:Few'}}", "not of the form package.module:Name"),
        ("{samplr: {name: 'my_parts:Few'}}", "parts is 'samplr'.*do you mean sampler"),
        ("{sampler: {name: 'my_parts:Few', options: {most: [1]}}}", "options.most is a list"),
        ("{sampler: {nam: 'my_parts:Few'}}", "has no key 'nam'.*do you mean name"),
    ],
)
def test_what_is_wrong_is_said_before_a_run_begins(module, text, message):
    with pytest.raises(ScenarioError, match=message):
        for key, part in loaded(text).parts.items():
            load_part(key, part)


def test_reading_and_listing_scenarios_runs_no_code_of_others(tmp_path, monkeypatch, capsys):
    (tmp_path / "evil.py").write_text("raise SystemExit('run')")
    monkeypatch.chdir(tmp_path)
    for part in Part:
        text = f"{{parts: {{{part}: {{name: 'evil:Part'}}}}}}"
        scenario = parse_scenario(dump_scenario(load_scenario(FILE, "ReachCircular", text)))
        assert scenario.parts[part].name == "evil:Part"
    text = dump_scenario(
        load_scenario(FILE, "ReachCircular", "{parts: {motion: {name: 'evil:P'}}}")
    )
    Path("own.yaml").write_text("Mine:\n" + textwrap.indent(text, "  "))
    assert main(["scenarios", "--scenario-file", "own.yaml"]) == 0
    assert "by its own motion" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="run"):  # and a run does
        main(["run", "--scenario-file", "own.yaml"])


def test_options_that_the_part_does_not_take_are_refused_by_name(module):
    scenario = loaded("{sampler: {name: 'my_parts:Few', options: {mst: 3}}}")
    with pytest.raises(ScenarioError, match="parts.sampler: my_parts:Few cannot be made.*'mst'"):
        make_dynamic_grasp(scenario)


def test_a_motion_of_ones_own_moves_the_object(module):
    """As the scenario does, start and orientation drawn by its seed; and it is judged by it."""
    usual, own = loaded("{}"), loaded("{motion: {name: 'my_parts:Higher', options: {height: 0.2}}}")
    for t in (0.0, 1.3):
        above = make_motion(own).pose(t) - make_motion(usual).pose(t)
        np.testing.assert_allclose(above[2, 3], 0.2)
        assert np.count_nonzero(np.abs(above) > 1e-12) == 1
    diagram = make_dynamic_grasp(own)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.5)
    station = diagram.subsystems.station
    context = station.GetMyContextFromRoot(simulator.get_context())
    X_WO = station.GetOutputPort("object.pose").Eval(context).GetAsMatrix4()
    np.testing.assert_allclose(X_WO, make_motion(own).pose(0.5), atol=2e-3)


@pytest.mark.parametrize(
    ("name", "message"),
    [("Few", "makes a Few; derive from ObjectMotion"), ("Wrong", r"shapes \[\(4, 4\), \(6,\)\]")],
)
def test_what_is_no_motion_is_refused(module, name, message):
    with pytest.raises(ScenarioError, match=f"parts.motion: my_parts:{name}.*{message}"):
        make_motion(loaded(f"{{motion: {{name: 'my_parts:{name}'}}}}"))
