"""What travels comes out as it went in."""

from types import MappingProxyType

import numpy as np
from pydrake.perception import PointCloud
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.remote.served import packed, unpacked


def test_clouds_and_images():
    cloud, depth, labels = PointCloud(3), ImageDepth32F(4, 2), ImageLabel16I(3, 2)
    cloud.mutable_xyzs()[:] = np.arange(9.0).reshape(3, 3)
    cloud.mutable_xyzs()[0, 0] = np.inf
    depth.mutable_data[:] = np.arange(8.0).reshape(2, 4, 1)
    labels.mutable_data[:] = np.arange(6).reshape(2, 3, 1)
    cloud_2, depth_2, labels_2 = unpacked(packed((cloud, depth, labels)))
    np.testing.assert_array_equal(cloud.xyzs(), cloud_2.xyzs())
    np.testing.assert_array_equal(depth.data, depth_2.data)
    np.testing.assert_array_equal(labels.data, labels_2.data)
    assert type(depth_2) is ImageDepth32F and type(labels_2) is ImageLabel16I


def test_what_is_read_only_stays_so():
    """Compiled functions take the two for different types, and would be compiled anew."""
    rejected = MappingProxyType({"too wide": 2})
    grasps = GraspSet(np.eye(4)[None], np.zeros(1), np.ones(1), rejected)
    field = fit_gpdf(sphere_points(64, 0.03))
    grasps_2, field_2 = unpacked(packed((grasps, field)))
    assert grasps_2.rejected == rejected
    for value, other in ((grasps, grasps_2), (field, field_2)):
        arrays = {k: v for k, v in vars(value).items() if isinstance(v, np.ndarray)}
        assert arrays
        for name, array in arrays.items():
            found = getattr(other, name)
            np.testing.assert_array_equal(array, found)
            assert array.flags.writeable == found.flags.writeable, name
            assert array.flags.f_contiguous == found.flags.f_contiguous, name
