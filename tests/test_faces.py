"""The front door: what packages hand on, and what importing them costs."""

import importlib
import subprocess
import sys
from types import ModuleType

import pytest

from tools.make_docs import faces

PROMISED = {
    "feasigrasp": "Result load_scenario make_dynamic_grasp run perceive read_cloud complete_shape "
    "filter_grasps Reachability SafetyFilter load_object",
    "feasigrasp.models.shape": "Gpdf CompletedField fit_gpdf complete_shape SceneField fit_scene",
    "feasigrasp.models.clouds": "FusedCloud read_cloud prepare_cloud",
    "feasigrasp.models.sensors": "DepthNoise CameraErrors Material",
    "feasigrasp.models.grasps": "GraspSet perceive make_sampler AntipodalSampler NetworkSampler "
    "filter_grasps",
    "feasigrasp.models.robot": "ParallelGripper SuctionCup WSG_50 forward_kinematics "
    "pose_and_jacobian manipulability",
    "feasigrasp.models.ik": "closed_form",
    "feasigrasp.models.reach": "Reachability feasible_grasps InterceptionOptions",
    "feasigrasp.models.control": "Safety SafetyOptions HorizonOptions ProgramOptions",
    "feasigrasp.models.objects": "RigidObject load_object HarmonicMotion",
    "feasigrasp.scenario": "Scenario load_scenario dump_scenario make_motion",
    "feasigrasp.systems": "Station StationConfig SegmentPointCloud PointCloudToGPDF GraspSampler "
    "ReachabilityFilter GripperSequencer RMMTaskController GPJointController VelocityDrive "
    "ObjectTracker Metrics make_dynamic_grasp GraspController ControllerInputs",
}


@pytest.mark.parametrize("face", PROMISED)
def test_a_face_hands_on_what_is_promised(face):
    module = importlib.import_module(face)
    for name in PROMISED[face].split():
        assert name in module.__all__
        assert not isinstance(getattr(module, name), ModuleType)
        assert getattr(module, name).__doc__


@pytest.mark.parametrize("face", faces())
def test_all_public_names_exist(face):
    module = importlib.import_module(face)
    assert len(module.__all__) <= (26 if face == "feasigrasp" else 18)
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_that_name"):
        _ = module.nothing_of_that_name


def test_the_numerics_load_neither_drake_nor_torch():
    """One after the other in one process: the first that fails is to blame."""
    numerics = [face for face in faces() if ".models" in face]
    code = "import sys\n" + "".join(
        f"import {face}; print([m for m in ('pydrake', 'torch') if m in sys.modules])\n"
        for face in numerics
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = dict(zip(numerics, done.stdout.splitlines(), strict=True))
    assert loaded == dict.fromkeys(numerics, "[]")


def test_every_name_is_completed_and_completing_loads_nothing():
    """What a notebook offers behind a face's dot: all public names, Drake and torch unloaded."""
    code = (
        "import sys, importlib\n"
        f"for face in {faces()}:\n"
        "    module = importlib.import_module(face) if '.scenario' not in face else None\n"
        "    missing = set(module.__all__) - set(dir(module)) if module else set()\n"
        "    print(face, sorted(missing), [m for m in ('pydrake', 'torch') if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{face} [] []" for face in faces()]


def test_the_front_door_is_light():
    """Importing it loads nothing but itself: neither NumPy nor what is behind the names."""
    code = "import sys; before = set(sys.modules); import feasigrasp\n"
    code += "print(sorted(m for m in set(sys.modules) - before if 'feasigrasp' in m))\n"
    code += "print([m for m in ('numpy', 'pydrake', 'torch') if m in set(sys.modules) - before])"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["['feasigrasp']", "[]"]
