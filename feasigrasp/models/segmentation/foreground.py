"""Which pixels of a depth image show the object, by depth and what is known of the cell.

1. What is known, the robot at its measured joints or the cell that stands still, is not the object
   (`feasigrasp.models.segmentation.known_bodies`), nor is what carries it, if that has a known
   colour (`feasigrasp.models.segmentation.hue`).
2. What is left is cut into components, `components`; pixels that belong to none (those that fly
   between two surfaces, above all) show nothing clear.
3. With a field of the object, the components are kept that agree with it at the predicted pose.
4. Without one, or when the object was lost, the components are grouped to bodies. A box that
   somebody drew decides which is the object; else there may be one only; else those that move,
   seen from an earlier view, which are waited for for a while; of those, or if none does of all,
   that nearest to where the object was or, before it was seen, to the hand or whatever else it is
   looked for from.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, find_objects

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.segmentation.camera_view import CameraView
from feasigrasp.models.segmentation.components import Components, find_components
from feasigrasp.models.segmentation.evidence import (
    LEAST_MOVED,
    DistanceField,
    agreeing,
    in_box,
    moved_share,
    nearest_to,
)
from feasigrasp.models.segmentation.known_bodies import (
    CARRIER,
    CELL,
    FREE,
    ROBOT,
    SIGMAS,
    UNSEEN,
)

#: Farther from the hand than this is nothing to be grasped now [m].
WITHIN = 1.0
#: Which of several bodies moves is waited for so long [s].
PATIENCE = 1.0
#: A body moves as well that has moved this share of what the one did that has moved most.
_AS_MUCH = 0.25
#: A body that shows less than this share of the largest one's pixels is a piece of one.
_LEAST_SIZE = 0.2
_AROUND = np.ones((3, 3), dtype=bool)


class Label(IntEnum):
    """What a pixel shows. ``UNCLEAR`` is of no surface, or of one that may be the object.

    ``CARRIER`` is what holds the object.
    """

    SURROUNDINGS = 0
    OBJECT = 1
    ROBOT = 2
    UNCLEAR = 3
    CARRIER = 4


class Known(NamedTuple):
    """What is known when an image is taken.

    Attributes:
        field: The object's distance field in O; None as long as there is none.
        X_WO: Its predicted pose, shape (4, 4); NaN if it is not known.
        lost: Whether that pose is good for nothing but to say where it was.
        before: An earlier view, by which is told what moves.
        waited: How long has been waited for something to move [s].
        box: What somebody drew about the object: first column and row, last ones, shape (4,) [px].
    """

    field: DistanceField | None = None
    X_WO: Array | None = None
    lost: bool = False
    before: CameraView | None = None
    waited: float = np.inf
    box: Array | None = None


def segment(
    view: CameraView, known: Known, kinds: NDArray[np.uint8], p_WH: Array, camera: Camera
) -> NDArray[np.int16]:
    """Labels the pixels of a depth image.

    Args:
        view: The image.
        known: What is known besides.
        kinds: What each pixel shows that is known, see `KnownBodies.kinds`, or `CARRIER`, shape
            (n,).
        p_WH: The object is looked for about this point, that of the hand, shape (3,) [m].
        camera: The camera.

    Returns:
        A `Label` for each pixel, shape (height, width). Pixels without depth amid the object count
        as the object's.
    """
    free = kinds == FREE
    where = np.flatnonzero(free)
    far = np.square(view.points[where] - p_WH).sum(axis=1) > WITHIN**2
    free[where[far]] = False
    components = find_components(view.points, free, view.X_WC[:3, 3], camera)

    labels = np.full(len(kinds), Label.UNCLEAR, dtype=np.int16)
    labels[(kinds == CELL) | (kinds == UNSEEN)] = Label.SURROUNDINGS
    labels[kinds == ROBOT] = Label.ROBOT
    labels[kinds == CARRIER] = Label.CARRIER
    followed = _followed(components, view, known)
    if followed is None:
        group = _chosen(components, known, p_WH, camera)
        found = components.mask(group)
    else:
        found = followed
        if found.any():  # with the object found, the rest is none
            labels[components.number >= 0] = Label.SURROUNDINGS
    image = labels.reshape(camera.height, camera.width)
    image[_closed(found.reshape(image.shape), (kinds == UNSEEN).reshape(image.shape))] = (
        Label.OBJECT
    )
    return image


def _followed(components: Components, view: CameraView, known: Known) -> Mask | None:
    """The pixels that agree with the field at the predicted pose; None without field or pose."""
    pose = known.X_WO
    if known.field is None or known.lost or pose is None or not np.isfinite(pose).all():
        return None
    kept, single = agreeing(components, view.points, known.field, pose)
    mask = components.mask(kept)
    mask[single] = True
    return mask


def _chosen(components: Components, known: Known, p_WH: Array, camera: Camera) -> Indices:
    """The components of the body that is taken for the object."""
    groups = components.groups()
    pixels = [components.pixels[group].sum() for group in groups]
    groups = [g for g, n in zip(groups, pixels, strict=True) if n >= _LEAST_SIZE * max(pixels)]
    if not groups:
        return np.zeros(0, dtype=np.int64)
    if known.box is not None:
        at = in_box([components.mask(group) for group in groups], camera, known.box)
        return groups[at] if at is not None else np.zeros(0, dtype=np.int64)
    pose = known.X_WO
    was_seen = pose is not None and bool(np.isfinite(pose).all())
    if len(groups) > 1:
        moving = _moving(groups, components, known.before, camera)
        if not moving and not was_seen and known.waited < PATIENCE:
            return np.zeros(0, dtype=np.int64)
        groups = moving or groups
    near = pose[:3, 3] if pose is not None and was_seen else p_WH
    return groups[nearest_to(near, groups, components)]


def _moving(
    groups: list[Indices], components: Components, before: CameraView | None, camera: Camera
) -> list[Indices]:
    """Those of some bodies that have moved since an earlier view; none without one."""
    if before is None:
        return []
    shares = [
        moved_share(np.concatenate([components.samples[k] for k in group]), before, camera, SIGMAS)
        for group in groups
    ]
    if max(shares) <= LEAST_MOVED:
        return []
    least = _AS_MUCH * max(shares)
    return [group for group, share in zip(groups, shares, strict=True) if share >= least]


def _closed(mask: Mask, unseen: Mask) -> Mask:
    """The mask with the small holes in it where nothing was measured."""
    box = find_objects(mask.astype(np.int8))
    if not box:
        return mask
    around = tuple(slice(max(s.start - 2, 0), s.stop + 2) for s in box[0])
    closed = mask.copy()
    closed[around] |= binary_closing(mask[around], _AROUND) & unseen[around]
    return closed
