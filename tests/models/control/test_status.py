"""What is said of a situation, and that every code can be said."""

from dataclasses import replace
from itertools import combinations

import pytest

from feasigrasp.models.control.status import Situation, StatusCode, judge
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.tracking import Tracking

FINE = Situation(tracking=Tracking.of_age(0.0, 0.5), grasps=20, reachable=5, left=0.3)
LOST, NEVER = Tracking.of_age(2.0, 0.5), Tracking.of_age(float("inf"), 0.5)
CASES = [
    ({}, StatusCode.FOLLOWING, ""),
    ({"speed": 0.0}, StatusCode.BRAKING_FOR_OBSTACLE, "30 cm"),
    ({"speed": 0.0, "left": 0.001}, StatusCode.FOLLOWING, ""),
    (
        {"reachable": 0, "verdicts": {"joint limits": 7, "table": 3}},
        StatusCode.WAITING,
        "joint limits",
    ),
    # More than nine in ten for where the object is.
    (
        {"reachable": 0, "verdicts": {"wrist out of reach": 19, "joint limits": 1}},
        StatusCode.OUT_OF_REACH,
        "wrist",
    ),
    (
        {"reachable": 0, "verdicts": {"wrist out of reach": 9, "joint limits": 1}},
        StatusCode.WAITING,
        "wrist",
    ),
    (
        {"reachable": 0, "verdicts": {"wrist out of reach": 3, "table": 7}},
        StatusCode.BLOCKED_BY_TABLE,
        "table",
    ),
    ({"reachable": 0, "verdicts": {"joint limits": 7}}, StatusCode.WAITING, "joint limits"),
    ({"reachable": 0, "verdicts": {"hits the scene": 0}}, StatusCode.WAITING, "too uncertain"),
    (
        {"grasps": 0, "reachable": 0, "rejected": {"too wide": 9, "off the surface": 1}},
        StatusCode.NO_GRASP,
        "too wide",
    ),
    ({"seen": False, "grasps": 0, "reachable": 0}, StatusCode.NOTHING_SEEN, "no view"),
    (
        {"seen": False, "grasps": 0, "reachable": 0, "views_dropped": "5.4 m wide"},
        StatusCode.VIEWS_DROPPED,
        "5.4 m wide",
    ),
    ({"contradicted": True, "reachable": 0}, StatusCode.POSE_CONTRADICTED, "elsewhere"),
    ({"lapsed": True, "seen": False}, StatusCode.PERCEPTION_LAPSED, "process"),
    ({"tracking": LOST, "reachable": 0}, StatusCode.POSE_LOST, "2.0 s"),
    ({"tracking": NEVER, "reachable": 0}, StatusCode.POSE_LOST, "ever"),
    (
        {"tracking": LOST, "search_target": True, "reachable": 0},
        StatusCode.LOOKING_FOR_OBJECT,
        "2.0 s",
    ),
    ({"tracking": replace(LOST, jumping=True)}, StatusCode.POSE_JUMPED, "somewhere else"),
    (
        {"camera_contradicted": True, "tracking": LOST},
        StatusCode.CAMERA_CONTRADICTED,
        "frozen, mirrored",
    ),
    ({"phase": Phase.LIFT, "turned": 0.3}, StatusCode.SLIPPING, "turned 17 deg in the hand"),
    ({"phase": Phase.HOLD, "slipped": 0.012}, StatusCode.SLIPPING, "moved 12 mm"),
    ({"phase": Phase.SHAKE, "slipped": 0.003, "turned": 0.05}, StatusCode.HOLDING, ""),
    ({"phase": Phase.CLOSE, "speed": 0.0}, StatusCode.CLOSING, ""),
    ({"phase": Phase.LIFT, "tracking": LOST}, StatusCode.LIFTING, ""),
    ({"phase": Phase.SHAKE}, StatusCode.HOLDING, ""),
    ({"phase": Phase.HOLD}, StatusCode.HOLDING, ""),
    ({"phase": Phase.DONE}, StatusCode.DONE, ""),
    ({"touches": 1, "tracking": LOST}, StatusCode.TOUCHED, "gives way"),
    ({"touches": 1, "phase": Phase.CLOSE}, StatusCode.CLOSING, ""),
    ({"command_faults": 3, "phase": Phase.CLOSE}, StatusCode.COMMAND_FAULTY, "not finite"),
]


@pytest.mark.parametrize(("change", "code", "words"), CASES)
def test_the_first_thing_that_is_wrong_is_said(change, code, words):
    found, detail = judge(replace(FINE, **change))
    assert found is code
    assert words in detail


def test_every_code_can_be_said_and_has_its_place_in_the_docs(repository):
    assert {code for _, code, _ in CASES} == set(StatusCode)
    text = (repository / "docs" / "results_schema.md").read_text()
    section = text.split("### `status`")[-1].split("### ")[0]
    section = section.split("| code | meaning |")[1]  # the lines before name some of them too
    places = [section.index(f"`{code}`") for code in StatusCode]
    assert places == sorted(places)


def test_of_two_things_the_first_in_order_is_said():
    order = list(StatusCode)
    for one, other in combinations(CASES, 2):
        if not one[0].keys() & other[0].keys():  # else they cannot both be so
            found, _ = judge(replace(FINE, **one[0], **other[0]))
            assert found is min(one[1], other[1], key=order.index), (one, other)
