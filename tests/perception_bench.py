"""A perception system with inputs set by hand, which looks at a sphere."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator

from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
from feasigrasp.systems.ports import evaluate

RADIUS = 0.04
CAMERA = np.array([0.0, 0.0, 0.5])
POSES = [
    RigidTransform(),
    RigidTransform(RollPitchYaw(0.3, -1.2, 2.0), [0.5, -0.2, 0.6]),
    RigidTransform(RollPitchYaw(-2.0, 0.4, 0.9), [-1.0, 2.0, 0.1]),
]


def sphere(n=900, seed=0):
    """Points on a sphere about the origin, at random, so that none lies on a voxel's border."""
    p = np.random.default_rng(seed).normal(size=(n, 3))
    return RADIUS * p / np.linalg.norm(p, axis=1, keepdims=True)


def seen_from(points, camera):
    """The part of the sphere that faces the camera."""
    return points[points @ camera > RADIUS**2]


def cloud_of(points):
    cloud = PointCloud(len(points))
    cloud.mutable_xyzs()[:] = np.asarray(points).T
    return cloud


class Perception:
    """A perception system with a simulator whose inputs can be changed."""

    def __init__(self, **kwargs):
        self.dut = PointCloudToGPDF(**kwargs)
        self.simulator = Simulator(self.dut)
        self.context = self.simulator.get_mutable_context()

    def look(self, t, points_W, X_WO=POSES[0], p_WC=CAMERA):
        """Fixes what is seen and advances to t; what has been perceived by then."""
        fix = {"point_cloud": cloud_of(points_W), "object_pose": X_WO}
        X_WC = p_WC if isinstance(p_WC, RigidTransform) else RigidTransform(np.asarray(p_WC, float))
        fix["camera_pose"] = X_WC
        for name, value in fix.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)
        self.simulator.AdvanceTo(t)
        return self.dut.GetOutputPort("perceived").Eval(self.context)

    def gpdf(self):
        return evaluate(self.dut.GetOutputPort("gpdf"), self.context)

    def view_faults(self):
        return self.dut.GetOutputPort("view_faults").Eval(self.context)[0]

    def see_object(self, t, X_WO, p_OC=CAMERA):
        """Looks at the sphere at some pose from a camera that is fixed to the object."""
        visible = seen_from(sphere(), p_OC)
        return self.look(t, (X_WO @ visible.T).T, X_WO, X_WO @ p_OC)
