"""Pictures of objects, and where their far side is: what the hidden-side network learns from.

An object of our own stream of shapes is looked at from one to three random directions by the noisy
depth camera, and the distance field is fitted; rays cast from behind towards a camera tell where
the object ends behind every pixel of its picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.view_image import SIDE, ViewImage
from feasigrasp.models.shape.completion import ROUGH_POINTS, complete_shape
from feasigrasp.models.shape.hidden_side import features, picture_scale
from feasigrasp.models.shape.hidden_side_network import FEATURES
from feasigrasp.training.data.object_streams import ObjectStream
from feasigrasp.training.data.views import ViewedObject, fused, turning_views

#: Fewer points than this are no picture.
MIN_POINTS = 30
#: From how many directions an object is looked at; one of these at random.
_VIEWS = (1, 1, 2, 3)
#: It turns by so much between two views, least and most [deg].
_TURN = (10.0, 120.0)
#: Rays start this far behind the middle of the object [m].
_BEHIND = 1.0


def true_thickness(viewed: ViewedObject, image: ViewImage) -> Array:
    """From the pictured depth to where the object ends, along z of the camera.

    Returns:
        Shape (SIDE, SIDE) [m]; NaN outside the silhouette and where a line of sight misses.
    """
    rays = image.rays()[image.mask]
    length = np.linalg.norm(rays, axis=1)
    ways = rays @ image.X_OC[:3, :3].T / length[:, None]
    far = float(image.depth[image.mask].mean()) + _BEHIND
    starts = image.X_OC[:3, 3] + far * ways
    back = far - viewed.surface.cast(starts, -ways)[0]
    thickness = np.full(image.mask.shape, np.nan)
    thickness[image.mask] = np.where(
        np.isfinite(back), back / length - image.depth[image.mask], np.nan
    )
    return thickness


def object_pictures(
    stream: ObjectStream, index: int, views: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pictures of one object.

    Args:
        stream: The objects.
        index: Which one.
        views: How many pictures; fewer if it can hardly be seen.

    Returns:
        `features` of them, shape (n, FEATURES, SIDE, SIDE), and the true thickness in units of
        `picture_scale`, shape (n, SIDE, SIDE), NaN where there is none.
    """
    rng = np.random.default_rng([stream.seed, index, 40])
    viewed = ViewedObject(stream[index].obj)
    seen, truth = [], []
    for _ in range(views):
        cameras = turning_views(rng, viewed.center, int(rng.choice(_VIEWS)), _TURN)
        views_of = [viewed.view(X_OC, rng) for X_OC in cameras]
        cloud = fused([view for view in views_of if len(view.points) >= MIN_POINTS])
        if not cloud.images:
            continue
        image = cloud.images[rng.integers(len(cloud.images))]
        field = complete_shape(cloud, max_points=ROUGH_POINTS, learnt=False)
        seen.append(features(image, field))
        truth.append((true_thickness(viewed, image) / picture_scale(image)).astype(np.float32))
    if not seen:
        shape = (0, SIDE, SIDE)
        return np.zeros((0, FEATURES, SIDE, SIDE), np.float32), np.zeros(shape, np.float32)
    return np.stack(seen), np.stack(truth)
