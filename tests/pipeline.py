"""The scenario that tests of the whole pipeline run: a soup can, the same start every time."""

import re
from pathlib import Path

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario

FILE = diagram_path("dynamic.scenarios.yaml")
PAGE = Path(__file__).parents[1] / "docs/own_cell.md"
#: What the documentation puts on top of a scenario for a camera that does not move.
SECOND_CAMERA = re.findall(r"```yaml\n(cameras:.*?)```", PAGE.read_text(), re.DOTALL)[0]


def scenario(name="ReachLinearMocap", *texts, text=""):
    return load_scenario(FILE, name, "{object: {model: soup_can}, random_seed: 3}", *texts, text)
