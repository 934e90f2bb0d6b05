"""Perception of one cloud: completed surface, grasps, and reasons of rejection."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError, PointCloudError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import MIN_POINTS, checked_cloud, outliers, smeared
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.payload import payload_filtered, with_loads
from feasigrasp.models.grasps.samplers import SamplerName, make_sampler
from feasigrasp.models.quantities import CLOUD, POINT, ArrayOf, Positive, Whole
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.segmentation.tabletop import check_no_table
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf


@dataclass(frozen=True, eq=False)
class Perception:
    """Completed surface and grasps of one cloud.

    Attributes:
        cloud: The cloud, one point per voxel, with directions to the camera.
        gpdf: The distance field fitted to it.
        grasps: The grasps that the filter kept, and why it dropped the others.
        gripper: The hand they are for.
        viewpoint: Where the camera was, shape (3,) [m]; None for a cloud of several views.
        outliers: How many points were dropped as outliers before anything else.
        down: Direction of gravity, shape (3,); None if it is not known.
    """

    cloud: FusedCloud
    gpdf: Gpdf
    grasps: GraspSet
    gripper: Gripper
    viewpoint: Annotated[Array, POINT] | None
    outliers: Whole
    down: Annotated[Array, POINT] | None = None

    def __post_init__(self) -> None:
        check_fields(self, GraspError)


@checked(PointCloudError)
def perceive(
    points: Annotated[ArrayLike, CLOUD],
    viewpoint: Annotated[ArrayLike, POINT] | None = (0.0, 0.0, 0.0),
    *,
    sampler: str | GraspSamplerFn = SamplerName.NETWORK,
    voxel_size: Positive = 0.003,
    gripper: Gripper | None = None,
    seed: Whole = 0,
    mass: Positive | None = None,
    down: Annotated[ArrayLike, POINT] | None = None,
    table: Annotated[ArrayLike, ArrayOf((4,))] | None = None,
) -> Perception:
    """Fits the distance field to one cloud of an object and samples grasps, as the pipeline does.

    The shortest way from points to grasps::

        found = perceive(read_cloud("mug.ply"))
        print(len(found.grasps), dict(found.grasps.rejected))

    Args:
        points: Shape (n, 3) [m].
        viewpoint: Where the camera was, shape (3,) [m]; None for a cloud of several views.
        sampler: One of `SamplerName`, or anything called like one, ``sampler(gpdf) -> GraspSet``.
        voxel_size: Resolution at which points are averaged [m].
        gripper: The hand; the default one unless given. A sampler of your own has its own.
        seed: Of a sampler that draws, see `make_sampler`.
        mass: Mass of the object, if it is known [kg]; else it is estimated from its volume.
        down: Direction of gravity, shape (3,); see `payload_filtered`.
        table: The plane that the object stands on, as `table_plane` finds it, shape (4,); for a
            cloud with a viewpoint. It closes the shape from below, and no hand goes through it.

    Returns:
        The field and the grasps in the frame of the points; `GraspSet.rejected` counts by
        `Rejection` what was found and dropped.

    Raises:
        PointCloudError: A cloud that no field can be fitted to, or that shows a table.
        GraspError: There is no such sampler.
    """
    gripper = gripper or ParallelGripper()
    if isinstance(sampler, str):
        sampler = make_sampler(sampler, gripper, seed=seed)
    view = None if viewpoint is None else np.asarray(viewpoint)
    points = checked_cloud(points)
    plane = None if table is None else np.asarray(table)
    if plane is None:
        check_no_table(points, view)
    bad = np.zeros(len(points), dtype=bool) if view is None else smeared(points, view)
    bad[~bad] = outliers(points[~bad], view)
    points = checked_cloud(points[~bad])
    # Without a camera there is no free space; the normals point away from the middle.
    cloud = FusedCloud.empty(voxel_size, smooth=view is not None)
    cloud = cloud.merged(points, np.zeros(3) if view is None else view)
    if len(cloud.points) < MIN_POINTS:
        raise PointCloudError(
            f"voxels of {voxel_size:g} m leave {len(cloud.points)} of {len(points)} points; give "
            "smaller ones (--voxel), or a denser cloud"
        )
    gpdf = fit_gpdf(cloud.points) if view is None else complete_shape(cloud, table=plane)
    g = None if down is None else np.asarray(down)
    grasps = payload_filtered(with_loads(gpdf, sampler(gpdf), gripper, mass), g)
    return Perception(cloud, gpdf, grasps, gripper, view, int(bad.sum()), g)
