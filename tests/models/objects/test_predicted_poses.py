"""What a plan takes the object to do."""

import numpy as np

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.prediction import MotionEstimate, PredictionModel, predicted_poses

X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.4])
V_WO = np.array([0.0, 0.1, 0.3, 0.1, -0.2, 0.0])
TIMES = np.array([0.0, 0.5, 2.0])


def test_without_look_ahead_the_object_stays():
    poses = predicted_poses(PredictionModel.NONE, None, X_WO, V_WO, TIMES)
    np.testing.assert_array_equal(poses, np.array([X_WO] * 3))


def test_with_its_twist_it_goes_on_as_a_rigid_body():
    class Liar(MotionEstimate):
        def predict(self, ahead):
            raise AssertionError("the prediction is not to be asked")

    poses = predicted_poses(PredictionModel.TWIST, object.__new__(Liar), X_WO, V_WO, TIMES)
    np.testing.assert_allclose(poses[0], X_WO)
    # Central difference of the second pose is the twist.
    a, b = (predicted_poses("twist", None, X_WO, V_WO, [0.5 + s])[0] for s in (-1e-5, 1e-5))
    np.testing.assert_allclose((b - a)[:3, 3] / 2e-5, V_WO[3:], atol=1e-6)
    spin = se3.so3_log(b[:3, :3] @ a[:3, :3].T) / 2e-5
    np.testing.assert_allclose(spin, V_WO[:3], atol=1e-6)
