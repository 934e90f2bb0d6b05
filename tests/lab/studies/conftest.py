"""Studies without simulations."""

import json

import pytest

from feasigrasp.runs.run import crash_record
from feasigrasp_lab.runs import isolated


@pytest.fixture
def fake_simulation(monkeypatch):
    """``fake_simulation(held, **timings)`` replaces the simulation; gives the list of what ran.

    ``held(scenario, name)`` says whether the object is held in the end.
    """

    def fake(held, **timings):
        ran = []

        def run(scenario, name, filename, *, replay=None):
            ran.append(filename.stem)
            made = crash_record(scenario, name, "") | {"error": None}
            success = held(scenario, name)
            made["metrics"] |= {"grasp_held": success, "cause": None if success else "slipped"}
            made["timings"] |= timings
            filename.write_text(json.dumps(made))
            return made

        monkeypatch.setattr(isolated, "run_isolated", run)
        return ran

    return fake
