"""Foreground segmentation of a depth image against the modeled robot and cell.

1. What is known, the robot at its measured joints or the cell that stands still, is not the object,
   nor is what carries it, if that has a known color
   (`feasigrasp.models.segmentation.modeled_bodies`).
2. What is left is cut into components, `components`; pixels that belong to none (those that fly
   between two surfaces, above all) show nothing clear. What is too large to be grasped, such as a
   wall, is of the surroundings.
3. With a field of the object, the components are kept that agree with it at the predicted pose.
4. Without one, or when the object was lost, the components are grouped to bodies. A box that
   somebody drew decides which is the object; else there may be one only; else those that move,
   seen from an earlier view, which are waited for for a while; of those, or if none does of all,
   that nearest to where the object was or, before it was seen, to the hand or whatever else it is
   looked for from.
"""

from dataclasses import dataclass
from enum import IntEnum
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, find_objects

from feasigrasp.models.arrays import Array, Floats, Frozen, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.segmentation.components import Components, find_components
from feasigrasp.models.segmentation.modeled_bodies import SIGMAS, Kind


@dataclass(frozen=True, eq=False)
class CameraView(Frozen):
    """One depth image.

    Attributes:
        points: Points in the world frame W, row by row, not finite where nothing was measured,
            shape (height * width, 3) [m].
        X_WC: Pose of the camera, z forward, x to the right, y down, shape (4, 4).
    """

    points: Floats
    X_WC: Array


class DistanceField(Protocol):
    """Interface of the object's distance field; a `Gpdf` is one."""

    @property
    def bounds(self) -> Array:
        """Lower and upper corner of the object, shape (2, 3) [m]."""

    def distance_and_gradient(self, x: Array) -> tuple[Array, Array]:
        """Raw distance (m,) and its gradient (m, 3) at x (m, 3)."""


def distance_to(field: DistanceField, points_O: Array, within: float = 0.0) -> Array:
    """First-order distance ``|d| / |grad d|`` of points (m, 3) from the field's zero, (m,) [m].

    Infinite for what is farther than ``within`` [m], and than 3 cm, beside its bounds.
    """
    low, high = field.bounds
    near = np.maximum(low - points_O, points_O - high).max(axis=1) <= max(within, 0.03)
    distance = np.full(len(points_O), np.inf)
    d, gradient = field.distance_and_gradient(np.ascontiguousarray(points_O[near]))
    distance[near] = np.abs(d) / np.maximum(np.linalg.norm(gradient, axis=1), 0.2)
    return distance


def moved_share(points: Array, before: CameraView, camera: Camera) -> float:
    """The share of a body's points (m, 3) that lie where an earlier view has looked through.

    Of those that the earlier view would have shown, in [0, 1]; 0 if it shows none.
    """
    X_CW = inverse_kernel(np.ascontiguousarray(before.X_WC))
    points_C = _to(X_CW, points)
    z, (u, v) = points_C[:, 2], (np.rint(c).astype(np.int64) for c in camera.pixels(points_C))
    inside = (z > 0.0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    if not inside.any():
        return 0.0
    u, v, z = u[inside], v[inside], z[inside]
    z_before = np.full(len(z), np.inf)
    # It has, if the view looked through beside it as well: the rim of a body at rest is a pixel
    # farther out now and then.
    for down, right in product((-1, 0, 1), repeat=2):
        row = np.clip(v + down, 0, camera.height - 1)
        pixel = row * camera.width + np.clip(u + right, 0, camera.width - 1)
        with np.errstate(invalid="ignore"):  # infinite where nothing was measured
            depth = _to(X_CW, before.points[pixel].astype(float))[:, 2]
        z_before = np.fmin(z_before, np.where(np.isfinite(depth), depth, np.inf))
    # A point that lies this much before what an earlier view saw there has come there since [m].
    off = 0.008 + SIGMAS * camera.depth_noise * z**2
    shown = z_before > z - off  # what was hidden may have been there
    came = np.count_nonzero(z_before > z + off)
    return float(came) / max(int(np.count_nonzero(shown)), 1)


def _to(X: Array, points: Array) -> Array:
    return np.asarray(points @ X[:3, :3].T + X[:3, 3])


class Label(IntEnum):
    """Label of a pixel. ``UNCLEAR`` is of no surface, or of one that may be the object.

    ``CARRIER`` is what holds the object.
    """

    SURROUNDINGS = 0
    OBJECT = 1
    ROBOT = 2
    UNCLEAR = 3
    CARRIER = 4


class Known(NamedTuple):
    """Prior knowledge for the segmentation of an image.

    Attributes:
        field: The object's distance field in O; None as long as there is none.
        X_WO: Its predicted pose, shape (4, 4); NaN if it is not known.
        lost: Whether that pose is good for nothing but to say where it was.
        before: An earlier view, for the detection of motion.
        waited: How long has been waited for something to move [s].
        box: What somebody drew about the object: first column and row, last ones, as for a click
            twice the same, shape (4,) [px]; the body with the most pixels in it is the object.
        slack: How far off ``X_WO`` may be, beside what is usual [m].
    """

    field: DistanceField | None = None
    X_WO: Array | None = None
    lost: bool = False
    before: CameraView | None = None
    waited: float = np.inf
    box: Array | None = None
    slack: float = 0.0


def segment(
    view: CameraView, known: Known, kinds: NDArray[np.uint8], p_WH: Array, camera: Camera
) -> NDArray[np.int16]:
    """A `Label` for each pixel of a depth image, shape (height, width).

    The kinds (n,) say what pixels show that is known, see `ModeledBodies.kinds`, or `CARRIER`. The
    object is looked for about p_WH (3,) [m], the place of the hand. Pixels without depth amid the
    object count as the object's.
    """
    free = kinds == Kind.FREE
    where = np.flatnonzero(free)
    # Farther from the hand than this is nothing to be grasped now [m].
    within = 1.0
    far = np.square(view.points[where] - p_WH).sum(axis=1) > within**2
    free[where[far]] = False
    components = find_components(view.points, free, view.X_WC[:3, 3], camera)

    labels = np.full(len(kinds), Label.UNCLEAR, dtype=np.int16)
    labels[(kinds == Kind.CELL) | (kinds == Kind.UNOBSERVED)] = Label.SURROUNDINGS
    labels[kinds == Kind.ROBOT] = Label.ROBOT
    labels[kinds == Kind.CARRIER] = Label.CARRIER
    graspable = components.graspable()
    labels[(components.number >= 0) & ~components.mask(graspable)] = Label.SURROUNDINGS
    found = _followed(components, view, known)
    if found is None:
        found = components.mask(_chosen(components, known, p_WH, camera))
    elif found.any():  # with the object found, the rest is none
        labels[components.number >= 0] = Label.SURROUNDINGS
    image = labels.reshape(camera.height, camera.width)
    unobserved = (kinds == Kind.UNOBSERVED).reshape(image.shape)
    image[_closed(found.reshape(image.shape), unobserved)] = Label.OBJECT
    return image


def _followed(components: Components, view: CameraView, known: Known) -> Mask | None:
    """The pixels that agree with the field at the predicted pose; None without field or pose.

    A component is the object's if most of it is near the field's zero. What else is near it, amid a
    larger body that the object touches, is found pixel by pixel.
    """
    # A component of which this share agrees is of the object; of others only single pixels are,
    # which are nearer to the surface than this [m].
    agreeing_share, nearest = 0.5, 0.006
    field, pose = known.field, known.X_WO
    if field is None or known.lost or pose is None or not np.isfinite(pose).all():
        return None
    X_OW = inverse_kernel(np.ascontiguousarray(pose))
    # A point agrees with the field that is no farther from its zero [m]: the error of the predicted
    # pose and of the side of the object that was not seen yet.
    gate = 0.02 + known.slack
    mask = np.zeros(len(components.number), dtype=bool)
    for k, sample in enumerate(components.samples):
        near = distance_to(field, _to(X_OW, sample[::3]), gate) < gate  # a third will do
        pixels = np.flatnonzero(components.number == k)
        if near.mean() < agreeing_share:
            distance = distance_to(field, _to(X_OW, view.points[pixels].astype(float)))
            pixels = pixels[distance < nearest + known.slack]
        mask[pixels] = True
    return mask


def _chosen(components: Components, known: Known, p_WH: Array, camera: Camera) -> Indices:
    """The components of the body that is taken for the object."""
    groups = components.groups()
    pixels = [components.pixels[group].sum() for group in groups]
    # A body that shows less than this share of the largest one's pixels is a piece of one. Source:
    # guessed.
    groups = [g for g, n in zip(groups, pixels, strict=True) if n >= 0.2 * max(pixels)]
    if not groups:
        return np.zeros(0, dtype=np.int64)
    if known.box is not None:
        left, top, right, bottom = np.maximum(np.rint(known.box).astype(int), [0, 0, -1, -1])
        images = [components.mask(g).reshape(camera.height, camera.width) for g in groups]
        inside = [np.count_nonzero(m[top : bottom + 1, left : right + 1]) for m in images]
        return groups[int(np.argmax(inside))] if any(inside) else np.zeros(0, dtype=np.int64)
    pose = known.X_WO
    was_seen = pose is not None and bool(np.isfinite(pose).all())
    if len(groups) > 1:
        moving = _moving(groups, components, known.before, camera)
        # Which of several bodies moves is waited for so long [s].
        patience = 1.0
        if not moving and not was_seen and known.waited < patience:
            return np.zeros(0, dtype=np.int64)
        groups = moving or groups
    near = pose[:3, 3] if pose is not None and was_seen else p_WH
    apart = [np.linalg.norm(sample - near, axis=1).min() for sample in components.samples]
    return min(groups, key=lambda group: min(apart[k] for k in group))


def _moving(
    groups: list[Indices], components: Components, before: CameraView | None, camera: Camera
) -> list[Indices]:
    """Those of some bodies that have moved since an earlier view; none without one."""
    if before is None:
        return []
    shares = [
        moved_share(np.concatenate([components.samples[k] for k in group]), before, camera)
        for group in groups
    ]
    # A body moves of which more than this share has come where nothing was.
    if max(shares) <= 0.04:
        return []
    # A body moves as well that has moved this share of what the one did that has moved most.
    least = 0.25 * max(shares)
    return [group for group, share in zip(groups, shares, strict=True) if share >= least]


def _closed(mask: Mask, unobserved: Mask) -> Mask:
    """The mask with the small holes in it where nothing was measured."""
    box = find_objects(mask.astype(np.int8))
    if not box:
        return mask
    around = tuple(slice(max(s.start - 2, 0), s.stop + 2) for s in box[0])
    closed = mask.copy()
    # A pixel and its eight neighbours. Source: layout.
    closed[around] |= binary_closing(mask[around], np.ones((3, 3), dtype=bool)) & unobserved[around]
    return closed
