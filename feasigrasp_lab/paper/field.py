"""The paper's distance field: observed points alone, and marching by the raw distance."""

from typing import Any

from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf

#: ``fit_gpdf(cloud, **PAPER)``: no values beside the points, steps of d instead of Newton's.
PAPER: dict[str, Any] = {
    "length_scale": 0.3,
    "noise_variance": 0.0025,
    "surface_offset": None,
    "damped": False,
}


def complete_shape(
    cloud: FusedCloud, *, length_scale: float, noise_variance: float | None, max_points: int
) -> Gpdf:
    """The field ``paper``: fitted to merged views, without free space.

    Args:
        cloud: The views, not smoothed.
        length_scale: l of the kernel [m].
        noise_variance: s2 of the occupancy observations; None for the paper's 0.0025.
        max_points: Surface points that the field is fitted to.
    """
    settings = PAPER | {"length_scale": length_scale}
    if noise_variance is not None:
        settings["noise_variance"] = noise_variance
    return fit_gpdf(cloud.points, viewpoint=cloud.directions, max_points=max_points, **settings)
