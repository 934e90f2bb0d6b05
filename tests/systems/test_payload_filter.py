"""The carry filter judges by gravity as the object is turned."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from feasigrasp.models.grasps.grasp_set import GraspSet, MassEstimate
from feasigrasp.models.grasps.payload import PadLoad
from feasigrasp.systems.reachability_filter import PayloadFilter


def heavy_grasps():
    """Two grasps across x; the centre of mass is beside one along y, and along z of the other."""
    load = PadLoad(
        R_OG=np.tile(np.eye(3), (2, 1, 1)),
        lever=np.array([[0.0, 0.12, 0.0], [0.0, 0.0, 0.12]]),
        body=MassEstimate(0.6, 0.05, np.zeros(3), 0.0),
        force=np.full(2, 48.0),
        moment=np.tile([0.4, np.inf, np.inf], (2, 1)),
    )
    X_OG = np.tile(np.eye(4), (2, 1, 1))
    return GraspSet(X_OG, np.full(2, 0.04), np.full(2, 0.9), id=np.array([7, 8]), load=load)


def judged(grasps, X_WO):
    dut = PayloadFilter()
    context = dut.CreateDefaultContext()
    dut.GetInputPort("grasps").FixValue(context, grasps)
    dut.GetInputPort("object_pose").FixValue(context, X_WO)
    return dut.GetOutputPort("grasps").Eval(context)


def test_the_object_hangs_from_what_is_left():
    upright = judged(heavy_grasps(), RigidTransform([0.5, 0.0, 0.5]))
    assert upright.id.tolist() == [8] and upright.rejected == {"too heavy there": 1}
    on_its_side = judged(heavy_grasps(), RigidTransform(RollPitchYaw(np.pi / 2, 0, 0), [0, 0, 1]))
    assert on_its_side.id.tolist() == [7]


def test_an_unknown_pose_is_the_worst():
    lost = RigidTransform(np.full((3, 4), np.nan))
    both = judged(heavy_grasps(), lost)
    np.testing.assert_allclose(both.score[0], both.score[1])
    assert len(both) == 2


def test_grasps_that_nobody_weighed_pass():
    plain = GraspSet(np.eye(4)[None], [0.04], [0.9])
    assert judged(plain, RigidTransform()) is plain
