"""Faults in scenario files: what is read comes back, and what is none is refused."""

import dataclasses as dc
import math
import typing

import pytest

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.fault import Fault, PoseNan
from feasigrasp.models.faults.images import Outliers
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.faults import AnyFault
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario

FILE = diagram_path("dynamic.scenarios.yaml")
KINDS = typing.get_args(AnyFault)[1:]


def read(text):
    return load_scenario(FILE, "ReachLinearMocap", f"{{faults: {text}}}")


def test_a_scenario_has_no_fault_unless_it_says_so():
    assert load_scenario(FILE, "ReachLinearMocap").faults == []


def test_values_are_read_and_others_have_their_defaults():
    text = "[!Outliers {start: 2, duration: 5, share: 0.2}, !PoseNan {every: 3, duration: 0.5}]"
    assert read(text).faults == [
        Outliers(start=2.0, duration=5.0, every=math.inf, share=0.2, size=0.05),
        PoseNan(start=0.0, duration=0.5, every=3.0),
    ]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_fault_comes_back_from_its_text(kind):
    """With values that are not the defaults."""
    assert issubclass(kind, Fault)
    scenario = read(f"[!{kind.__name__} {{}}]")
    (fault,) = scenario.faults
    assert fault == kind()
    for entry in dc.fields(fault):
        value = getattr(fault, entry.name)
        if isinstance(value, list):
            setattr(fault, entry.name, [0.5, -0.25, 0.125])
        else:
            low, high, _ = entry.metadata["span"]
            setattr(fault, entry.name, type(value)(min(max(3, low), high)))
    fault.every = 7.5
    assert parse_scenario(dump_scenario(scenario)).faults == [fault] != [kind()]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[{start: 1.0}]", r"faults\[0\] does not say what it is; give one of !CameraGone, "),
        ("[!PoseNan {}, !Outliers {share: 2}]", r"faults\[1\] \(!Outliers\): share is 2.0"),
        ("[!PoseNan {duration: .nan}]", "duration is nan"),
        ("[!Outlier {}]", "Outlier"),
        ("[!Outliers {shar: 0.1}]", "shar"),
        ("[!MaskShifted {columns: 1.5}]", "columns"),
        ("[!PoseJump {by: [1, 2]}]", "by is .*; give x, y and z"),
        ("3", "faults|iterable"),
    ],
)
def test_what_is_no_fault_is_refused(text, message):
    with pytest.raises(ScenarioError, match=message):
        read(text)
