"""Requirements on a point cloud before a distance field is fitted to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array

#: Fewer points than this describe no surface.
MIN_POINTS = 8
#: Larger clouds are not one graspable object; most often they are in millimetres.
MAX_EXTENT = 2.0
#: Points that spread less than this (standard deviation) in two directions are a spot or line [m].
MIN_SPREAD = 2.5e-4


def spread_across(cloud: Array) -> float:
    """Standard deviation of points (n, 3), n > 1, along their second principal direction [m]."""
    second = np.linalg.eigvalsh(np.cov(cloud, rowvar=False))[1]
    return float(np.sqrt(max(second, 0.0)))


def checked_cloud(points: ArrayLike) -> Array:
    """A copy of the cloud as float64 (n, 3); raises PointCloudError for an invalid one."""
    cloud = np.array(points, dtype=float, order="C")
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise PointCloudError(f"point cloud has shape {cloud.shape}; give (n, 3) in metres")
    bad = int((~np.isfinite(cloud).all(axis=1)).sum())
    if bad:
        raise PointCloudError(
            f"{bad} of {len(cloud)} points hold NaN or infinity (invalid depth); drop them first"
        )
    if len(cloud) < MIN_POINTS:
        raise PointCloudError(
            f"{len(cloud)} points; a distance field needs at least {MIN_POINTS}. "
            "Is the object in view and the segmentation mask right?"
        )
    extent = float(np.ptp(cloud, axis=0).max())
    if extent > MAX_EXTENT:
        raise PointCloudError(
            f"the cloud is {extent:.3g} m wide, more than {MAX_EXTENT:g} m: is it in millimetres "
            "(multiply by 0.001), or does it hold the background too?"
        )
    spread = spread_across(cloud)
    if spread < MIN_SPREAD:
        raise PointCloudError(
            f"the points lie on one spot or line (extent {extent:.3g} m, spread across "
            f"{spread:.2g} m); a surface in metres is needed"
        )
    return cloud


def check_fit(
    length_scale: float, noise_variance: float, surface_offset: float | None, max_points: int
) -> None:
    """Refuses parameters of the fit that are out of range, by name."""
    for name, value in (("length_scale", length_scale), ("noise_variance", noise_variance)):
        if not (np.isfinite(value) and value > 0):
            raise PointCloudError(f"{name} = {value}; give a positive number")
    if surface_offset is not None and not 0 < surface_offset < length_scale:
        raise PointCloudError(
            f"surface_offset = {surface_offset}; give a length between 0 and length_scale "
            f"({length_scale:g} m), or None for the paper's field"
        )
    if max_points < MIN_POINTS:
        raise PointCloudError(f"max_points = {max_points}; give at least {MIN_POINTS}")


def directions_to_camera(cloud: Array, viewpoint: ArrayLike) -> Array:
    """Directions from the points to their cameras, (n, 3), given as such or as a position (3,)."""
    view = np.array(viewpoint, dtype=float)
    if not np.isfinite(view).all():
        raise PointCloudError("viewpoint holds NaN or infinity")
    if view.shape == (3,):
        return view - cloud
    if view.shape == cloud.shape:
        return view
    raise PointCloudError(
        f"viewpoint has shape {view.shape}; give the camera position (3,) or one direction to the "
        f"camera per point {cloud.shape}"
    )
