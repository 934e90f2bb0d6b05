import numpy as np
import pytest

from feasigrasp import cli
from feasigrasp.errors import ArgumentError
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.arm_model import arm_urdf
from feasigrasp.models.robot.urdf_arm import describe_urdf, fitted_capsule


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_model_of_an_arm_gives_the_arm_back(name, tmp_path):
    arm, urdf, file = load_arm(name), tmp_path / "arm.urdf", tmp_path / "arm.yaml"
    urdf.write_text(arm_urdf(arm))
    limits = [f"{a:g}" for a in arm.acceleration_limits]
    command = ["arm", urdf, "--flange", arm.link_names[-1], "--out", file, "--name", name]
    assert cli.main([*map(str, command), "--acceleration", *limits]) == 0
    made = load_arm(str(file))
    assert made.family == arm.family and made.name == name
    for what in ("points", "axes", "lower", "upper", "velocity_limits", "acceleration_limits"):
        np.testing.assert_allclose(getattr(made, what), getattr(arm, what), atol=1e-6)
    np.testing.assert_allclose(made.inertias, arm.inertias, atol=2e-5)
    for ours, theirs in zip(made.capsules, arm.capsules, strict=True):
        assert ours.radius == pytest.approx(theirs.radius, abs=0.006)


def test_a_fitted_capsule_holds_every_point():
    rng = np.random.default_rng(0)
    for size in ([0.1, 0.1, 0.3], [0.3, 0.05, 0.05], [0.1, 0.1, 0.1]):
        points = rng.uniform(-0.5, 0.5, (200, 3)) * size
        *ends, radius = fitted_capsule(points)
        a, b = np.array(ends[:3]), np.array(ends[3:])
        t = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        assert np.linalg.norm(points - a - t[:, None] * (b - a), axis=1).max() <= radius
        assert radius < 0.5 * np.linalg.norm(size) + 0.002


def test_what_is_no_arm_of_a_known_build_is_refused(tmp_path):
    arm, urdf = load_arm("panda"), tmp_path / "arm.urdf"
    text = arm_urdf(arm)
    urdf.write_text(text)
    with pytest.raises(ArgumentError, match="has no link 'tool0'; it has panda_link_0"):
        describe_urdf(urdf, "tool0")
    with pytest.raises(ArgumentError, match="an arm of 5 joints .* is of no build"):
        describe_urdf(urdf, "panda_link_5")
    urdf.write_text(text.replace('axis xyz="0 1 0"', 'axis xyz="0 0.8 0.6"'))
    with pytest.raises(ArgumentError, match="arms with axes along x, y and z"):
        describe_urdf(urdf, "panda_link_7")
    urdf.write_text(text.replace('type="revolute"', 'type="prismatic"', 1))
    with pytest.raises(ArgumentError, match="panda_joint_1 is prismatic; joints of an arm turn"):
        describe_urdf(urdf, "panda_link_7")
