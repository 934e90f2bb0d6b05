"""The scenario that tests of the whole pipeline run: a soup can, the same start every time."""

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario

FILE = diagram_path("dynamic.scenarios.yaml")


def scenario(name="ReachLinearMocap", *texts, text=""):
    return load_scenario(FILE, name, "{object: {model: soup_can}, random_seed: 3}", *texts, text)
