"""Files of arms: every mistake is refused by file, key and value."""

import re

import numpy as np
import pytest
import yaml

from feasigrasp.errors import ScenarioError
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.resources import model_path


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        ("joints 0 kp", -1, "joints [0] kp = -1; give a finite number of at least 0"),
        ("joints 6 velocity", -1, "joints [6] velocity = -1; give a finite number above 0"),
        ("joints 0 effort", np.nan, "joints [0] effort = nan; give a finite"),
        ("joints 0 lower", None, "joints [0] lower is None; give a finite number"),
        ("joints 0 lower", 3.0, "has lower 3, home 0 and upper 2.8973; give them in this order"),
        ("joints 0 home", 9.0, "home 9 and upper 2.8973"),
        ("joints 0 upper", 170.0, "are these degrees? Give radians"),
        ("joints 0 velocty", 1.0, "joints [0] has velocty; it may have point,"),
        ("joints 0 point", [0.0, 0.0], "joints [0] point has shape (2,); give numbers of shape"),
        ("joints 0 point", [0.0, 0.0, 333.0], "joints [0] point holds 333 m: are these mm?"),
        ("joints 0", "one", "joints [0] is 'one'; give point, axis"),
        ("joints", {}, "joints is a dict; give a list"),
        ("links", [], "links has 0 entries; give 8"),
        ("links 1 mass", 0.0, "links [1] mass = 0.0; give a finite number above 0"),
        (
            "links 1 inertia",
            [1, 0.1, 0.1, 0, 0, 0],
            "links [1] inertia has the moments 0.1, 0.1 and 1",
        ),
        ("links 1 capsules 0 6", -0.1, "links [1] capsules has a radius that is not positive"),
        ("links 1 capsules 0", [1, 2], "links [1] capsules [0] has shape (2,); give"),
        ("flange axes 0", [2.0, 0.0, 0.0], "flange axes [0] is no rotation"),
        ("pairs", [[0, 99]], "pairs [0] is 0, 99; give bodies from 0 to 11"),
        ("pairs 0", [1.5, 3], "pairs [0] holds float64; give whole numbers"),
        ("family", "foo", "family is 'foo'; choose one of srs, shoulder_wrist"),
        ("family", "parallel", "panda has 7 joints; arms of 6 are supported as parallel"),
        ("family", 3, "family is 3; give a str"),
        ("name", "my arm", "name is 'my arm'; give letters"),
        ("acceleration_share", 2.0, "acceleration_share = 2.0; give"),
        ("", [1, 2], "not a mapping; give keys"),
        ("", None, "not a mapping; give keys"),
        ("", {"name": "arm"}, "has no family; give it"),
    ],
)
def test_a_mistake_in_the_file_of_an_arm_is_named(keys, value, message, tmp_path):
    file, text = tmp_path / "a.yaml", model_path("arms", "panda.yaml").read_text()
    part = root = {"": yaml.safe_load(text)}
    *path, last = (int(key) if key.isdigit() else key for key in ("", *keys.split()))
    for key in path:
        part = part[key]
    part[last] = value
    file.write_text(yaml.safe_dump(root[""]))
    with pytest.raises(ScenarioError, match=f"^{re.escape(str(file))}: .*{re.escape(message)}"):
        load_arm(str(file))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("kp: 3200.0\n  kp: 320.0", "the key 'kp' is given twice, in line 19"),
        ("kp: 010", "line 19 has 010, which YAML reads as 8"),
    ],
)
def test_what_yaml_reads_otherwise_is_named(given, message, tmp_path):
    file = tmp_path / "arm.yaml"
    text = model_path("arms", "panda.yaml").read_text()
    file.write_text(text.replace("kp: 3200.0", given, 1))
    with pytest.raises(ScenarioError, match=rf"arm.yaml: {message}"):
        load_arm(str(file))


def test_a_file_that_has_changed_is_another_arm(tmp_path):
    file, text = tmp_path / "arm.yaml", model_path("arms", "panda.yaml").read_text()
    file.write_text(text)
    before = load_arm(str(file))
    assert load_arm(str(file)) is before
    file.write_text(text.replace("kp: 3200.0", "kp: 1e3"))
    assert before.kp[0] == 3200.0 and load_arm(str(file)).kp[0] == 1e3
