"""The pictures of the paper's figures 6 and 7, and what they count."""

import json

import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp_lab.studies.figures.joint_field_figures import Field, forward, inverse

#: A patch of targets in reach of the small arm, not the one of the picture [m].
TARGETS = np.array([[0.3, 0.5], [0.45, 0.35], [-0.2, 0.6], [0.1, 0.75]])


def test_configurations_of_the_small_arm_reach_their_targets():
    q = inverse(TARGETS)
    ends = forward(q)[:, 1]
    np.testing.assert_allclose(ends, np.concatenate([TARGETS, TARGETS]), atol=1e-12)
    assert np.linalg.norm(q[:4] - q[4:], axis=1).min() > 0.5  # two ways, not the same one twice


def test_the_drawn_field_is_zero_at_solutions_and_its_gradient_is_its_slope():
    field = Field.fit(inverse(TARGETS))
    assert field.evaluate(field.solutions)[0] == pytest.approx(np.zeros(8), abs=1e-5)
    q, step = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 2)), 1e-6
    gradient = field.evaluate(q)[1]
    for axis in range(2):
        offset = step * np.eye(2)[axis]
        slope = (field.evaluate(q + offset)[0] - field.evaluate(q - offset)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], slope, atol=1e-5)


def test_a_long_length_scale_blends_solutions():
    corner = np.stack(np.meshgrid([0.0, 0.5, 1.0], [1.0, 1.5, 2.0]), axis=-1).reshape(-1, 2)
    starts = np.random.default_rng(0).uniform(-2.0, 3.0, (30, 2))
    arrived = {}
    for scale in (0.1, 2.0):
        field = Field.fit(corner, scale)
        arrived[scale] = field.arrived(field.descend(starts)).mean()
    assert arrived[0.1] == 1.0
    assert arrived[2.0] < 0.8


@pytest.mark.parametrize(
    ("command", "picture"),
    [("mixture-figures", "mixture.png"), ("joint-field-figures", "joint_field.png")],
)
def test_the_picture_is_drawn(command, picture, tmp_path):
    assert cli.main(["evaluate", command, "--quick", "--out", str(tmp_path)]) == 0
    assert (tmp_path / picture).stat().st_size > 20_000
    rows = json.loads((tmp_path / "summary.json").read_text())["rows"]
    found = {(row["name"], row["preset"]): row["value"] for row in rows}
    if command == "mixture-figures":
        for what in ("means", "medoids"):
            assert found["mixture_figures.log_density_gain", what] > 100.0
    else:
        assert found["joint_field_figures.arrived_percent", "rule"] == 100.0
        assert found["joint_field_figures.arrived_percent", "l = 1"] < 80.0
