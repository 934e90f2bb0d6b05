import re
from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from feasigrasp import cli
from feasigrasp.errors import ArgumentError
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import Family
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.arm_model import arm_urdf
from feasigrasp.models.robot.kinematics import forward_kinematics
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


#: Of a Kinova Jaco (j2n6s200), whose last three axes are tilted and meet nowhere: turns about x
#: between joints [rad], ways along x and z [m], and limits [rad]. Source: its DH parameters.
JACO = [
    (np.pi / 2, 0.0, 0.2755, -6.28, 6.28),
    (np.pi, 0.41, 0.0, 0.82, 5.46),
    (np.pi / 2, 0.0, -0.0098, 0.33, 5.95),
    (np.pi / 3, 0.0, -0.25008, -6.28, 6.28),
    (np.pi / 3, 0.0, -0.08556, -6.28, 6.28),
    (np.pi, 0.0, -0.20278, -6.28, 6.28),
]
_LINK = """<link name="l{k}"><inertial><mass value="0.6"/><inertia ixx="0.002" iyy="0.002"
izz="0.002"/></inertial>
<collision><geometry><sphere radius="0.04"/></geometry></collision></link>"""
_JOINT = """<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{next}"/><origin
xyz="{x} 0 {z}" rpy="{turn} 0 0"/><axis xyz="0 0 1"/><limit lower="{low}" upper="{high}"
velocity="2" effort="40"/></joint>"""


def jaco_urdf():
    parts, place = [_LINK.format(k=0)], {"x": 0.0, "z": 0.0, "turn": 0.0}
    for k, (turn, x, z, low, high) in enumerate([*JACO, (0.0,) * 5]):
        kind = "revolute" if k < len(JACO) else "fixed"
        parts.append(_JOINT.format(k=k, next=k + 1, kind=kind, low=low, high=high, **place))
        parts.append(_LINK.format(k=k + 1) if kind == "revolute" else '<link name="l7"/>')
        place = {"x": x, "z": z, "turn": turn}
    return f"<robot name='jaco'>{''.join(parts)}</robot>"


def test_an_arm_that_fits_no_closed_form_is_seeded_and_its_model_is_drakes(tmp_path, capsys):
    urdf, file = tmp_path / "jaco.urdf", tmp_path / "jaco.yaml"
    urdf.write_text(jaco_urdf())
    assert cli.main(["arm", str(urdf), "--flange", "l7", "--out", str(file)]) == 0
    assert "6 joints, seeded" in capsys.readouterr().out
    arm = load_arm(str(file))
    assert arm.family == Family.SEEDED and (np.abs(arm.axes).max(axis=1) < 0.9).any()
    plants = []
    for text in (jaco_urdf(), arm_urdf(arm)):
        plant = MultibodyPlant(0.0)
        Parser(plant).AddModelsFromString(text, "urdf")
        root = plant.GetBodyByName("l0" if not plants else arm.link_names[0])
        plant.WeldFrames(plant.world_frame(), root.body_frame())
        plant.Finalize()
        plants.append((plant, plant.CreateDefaultContext()))
    reach = Reachability(arm=replace(arm, pairs=()), limit_margin=0.0, table_clearance=-5.0)
    for q in arm.random_positions(np.random.default_rng(0), 30):
        theirs, ours = (
            (plant.SetPositions(context, q), plant.GetBodyByName(name).EvalPoseInWorld(context))[1]
            for (plant, context), name in zip(plants, ("l6", arm.link_names[-1]), strict=True)
        )
        np.testing.assert_allclose(ours.translation(), theirs.translation(), atol=1e-6)
        X_WF = forward_kinematics(q, None, arm)
        flange = plants[1][0].GetFrameByName("jaco_flange").CalcPoseInWorld(plants[1][1])
        np.testing.assert_allclose(flange.GetAsMatrix4(), X_WF, atol=1e-9)
        assert reach.reachable((X_WF @ reach.gripper.X_FG)[None]).all()


def test_light_links_keep_their_centre_of_mass(tmp_path):
    urdf = tmp_path / "light.urdf"
    urdf.write_text(jaco_urdf().replace('value="0.6"', 'value="0.04"'))
    for link in describe_urdf(urdf, "l7")["links"]:
        np.testing.assert_allclose(link["com"], 0.0, atol=1e-6)


def test_what_is_no_arm_is_refused(tmp_path, capsys):
    arm, urdf = load_arm("panda"), tmp_path / "arm.urdf"
    text = arm_urdf(arm)
    urdf.write_text(text)
    with pytest.raises(ArgumentError, match="has no link 'tool0'; it has panda_link_0"):
        describe_urdf(urdf, "tool0")
    less = ["arm", str(urdf), "--flange", arm.link_names[-1], "--out", str(tmp_path / "less.yaml")]
    assert cli.main([*less, "--acceleration", "5", "5"]) == 2
    assert "--acceleration has 2 values, the arm 7 joints" in capsys.readouterr().err
    few = ["arm", str(urdf), "--flange", "panda_link_5", "--out", str(tmp_path / "few.yaml")]
    assert cli.main(few) == 2
    assert "few has 5 joints; arms of 6 or 7 are supported" in capsys.readouterr().err
    urdf.write_text(text.replace('type="revolute"', 'type="prismatic"', 1))
    with pytest.raises(ArgumentError, match="panda_joint_1 is prismatic; joints of an arm turn"):
        describe_urdf(urdf, "panda_link_7")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "robot", "is no URDF"),
        ('lower="-2', 'lower="${-pi}-2', "expand it first"),
        ('velocity="', 'velocity="-', "must be positive"),
        ('effort="', 'effort="-', "must be positive"),
        ('lower="-', 'lower="-100', "give radians"),
        ('<axis xyz="', '<axis xyz="0 0 0"/><axis xyz="', "its axis is"),
        ('xyz="0 0 0.333"', 'xyz="0 0 333"', "are these mm?"),
        ('<mass value="', '<mass value="-', "its mass is -"),
        ("<collision", "<nothing", None),
    ],
)
def test_a_mistake_in_a_urdf_is_named(old, new, words, tmp_path):
    text, urdf = arm_urdf(load_arm("panda")), tmp_path / "arm.urdf"
    if words is None:
        for tag in ("collision", "visual"):
            text = text.replace(f"<{tag}", "<nothing").replace(f"</{tag}", "</nothing")
        words = "no link has geometry"
    else:
        assert old in text
        text = text.replace(old, new, 1)
    urdf.write_text(text)
    with pytest.raises(ArgumentError, match=re.escape(words)):
        describe_urdf(urdf, "panda_link_7")


def test_joints_in_a_circle_are_named(tmp_path):
    text, urdf = arm_urdf(load_arm("panda")), tmp_path / "arm.urdf"
    back = '<joint name="back" type="fixed"><parent link="panda_link_7"/>'
    back += '<child link="panda_link_0"/></joint></robot>'
    urdf.write_text(text.replace("</robot>", back))
    with pytest.raises(ArgumentError, match="go in a circle"):
        describe_urdf(urdf, "panda_link_7")


def test_no_file_is_lost_and_what_cannot_be_written_is_said_first(tmp_path, capsys):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm_urdf(load_arm("panda")))
    before = urdf.read_text()
    command = ["arm", str(urdf), "--flange", "panda_link_7", "--out"]
    for more, words in (
        ([str(urdf)], "is the URDF itself"),
        ([str(tmp_path / "my arm.yaml")], "give letters"),
        ([str(tmp_path / "a.yaml"), "--name", "a/b"], "give letters"),
        ([str(tmp_path / "a.yaml"), "--acceleration", *"1111110"], "[6] acceleration = 0.0; give"),
        ([str(tmp_path / "a.yaml"), "--acceleration", "nan", *"111111"], "[0] acceleration = nan"),
    ):
        assert cli.main([*command, *more]) == 2
        assert words in capsys.readouterr().err
    assert urdf.read_text() == before and list(tmp_path.iterdir()) == [urdf]
    assert (
        cli.main(["arm", str(tmp_path / "none.urdf"), *command[2:], str(tmp_path / "a.yaml")]) == 2
    )
    assert "is no URDF (FileNotFoundError" in capsys.readouterr().err
