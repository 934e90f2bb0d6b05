"""Labels of pixels on the robot at its measured joints, on the static cell, and by color.

The arm is made of the capsules of `models.robot.capsules`, the hand of boxes that fit it closely,
since the object comes between its fingers, and the cell of boxes too. A point belongs to a body if
it lies in it, or no farther from it than `MARGIN` and what the camera's noise explains.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, Floats, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics


def in_color_gate(color: NDArray[np.uint8], hue_deg: float) -> Mask:
    """Mask of pixels with a hue, independent of brightness, row by row, (height * width,).

    The hue is 0 for red, 120 for green, 240 for blue [deg]. Of the channels of ``color``, (height,
    width, >= 3), in [0, 255], the first three count: red, green and blue.
    """
    # A pixel that is paler than this has no hue that could be relied on, nor one darker than that.
    least_saturation, least_value = 0.35, 0.06
    rgb = color.reshape(-1, color.shape[-1])[:, :3].astype(np.float32) / 255.0
    red, green, blue = rgb.T
    value, least = rgb.max(axis=1), rgb.min(axis=1)
    # The angle of the color about the grey axis; that of HSV differs by a degree at most.
    angle = np.arctan2(np.sqrt(3.0) * (green - blue), 2.0 * red - green - blue)
    off = np.abs((np.rad2deg(angle) - hue_deg + 180.0) % 360.0 - 180.0)
    vivid = value - least > least_saturation * np.maximum(value, least_value)
    # A pixel is of a hue that is no farther from it than this [deg].
    return np.asarray((off < 20.0) & vivid & (value > least_value))


@dataclass(frozen=True, eq=False)
class ColorHistogram(Frozen):
    """How probable it is that a color is the object's, where both kinds are as frequent.

    The histogram of the object against that of its surroundings (Swain and Ballard, "Color
    indexing", 1991, with that of the background in the ratio).

    Attributes:
        probability: By bin, shape (8 ** 3,).
    """

    probability: Array

    @classmethod
    def learnt(cls, color: NDArray[np.uint8], of_object: Mask, beside: Mask) -> Self:
        """The histograms of an image (h, w, 3), of pixels of the object and of something else."""
        # Pixels that every bin has beforehand, of either kind: unseen colors say nothing.
        prior = 5.0
        bins, number = _bins(color), 8**3
        on, off = (np.bincount(bins[mask], minlength=number) for mask in (of_object, beside))
        scale = max(float(on.sum()), 1.0) / max(float(off.sum()), 1.0)
        return cls((on + prior) / (on + scale * off + 2.0 * prior))

    def of(self, color: NDArray[np.uint8]) -> Array:
        """The probability of each pixel of an image (h, w, 3), shape (h, w)."""
        return np.asarray(self.probability[_bins(color)])


def _bins(color: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The bin of each pixel: the three highest bits of every channel."""
    high = (color >> 5).astype(np.int64)
    return (high[..., 0] << 6) | (high[..., 1] << 3) | high[..., 2]


class Kind(IntEnum):
    """Kinds of pixels; `ModeledBodies` gives all but the last one."""

    UNOBSERVED = 0
    FREE = 1
    ROBOT = 2
    CELL = 3
    CARRIER = 4


#: Largest error of the modeled poses of bodies [m]. Source: guessed.
MARGIN = 0.005
#: Number of standard deviations of a depth that is noise. Source: guessed.
SIGMAS = 3.0


class Boxes(NamedTuple):
    """Boxes in the world.

    Attributes:
        X_WB: Poses of their middles, shape (k, 4, 4); none by default.
        half: Half their sizes, shape (k, 3) [m].
        solid: Which are bodies themselves, and not boxes about some, shape (k,); none by default.
    """

    X_WB: Array = np.zeros((0, 4, 4))
    half: Array = np.zeros((0, 3))
    solid: Mask = np.zeros(0, dtype=bool)


def hand_boxes(gripper: Gripper, X_WG: Array, opening: float) -> Boxes:
    """Fingers, guide and palm of a hand, its mount, and the camera on its bracket.

    Of a hand with its grasp frame at X_WG (4, 4), and its pads ``opening`` apart [m].
    """
    # Half the width of what joins palm and flange; of the bracket that carries the camera, half its
    # width, how far it reaches behind the palm, and how far beyond the camera's middle [m].
    mount_half = 0.034
    bracket_half, bracket_depth, bracket_reach = 0.018, 0.026, 0.015
    # The guide in which the fingers run is wider than they are, and so long [m].
    guide_rim, guide_length = 0.003, 0.014
    heel, palm = gripper.heel, np.array(gripper.palm_size)
    back = heel - palm[2]
    guide = np.array([gripper.reach[0] + guide_rim, gripper.reach[1] + guide_rim])
    mount = np.array([mount_half, mount_half])
    camera, housing = np.array(gripper.camera_center), np.array(gripper.camera_box) / 2
    # Lower and upper corners in G.
    corners = np.array(
        [
            *gripper.fingers(opening),
            [[*-guide, heel], [*guide, heel + guide_length]],
            [[*-palm[:2] / 2, back], [*palm[:2] / 2, heel]],
            [[*-mount, -gripper.tool_offset], [*mount, back]],
            [
                [-bracket_half, 0.0, back - bracket_depth],
                [bracket_half, camera[1] + bracket_reach, back],
            ],
            [camera - housing, camera + housing],
        ]
    )
    X_GB = np.tile(np.eye(4), (len(corners), 1, 1))
    X_GB[:, :3, 3] = corners.mean(axis=1)
    return Boxes(X_WG @ X_GB, 0.5 * np.ptp(corners, axis=1))


class ModeledBodies:
    """The robot and its cell."""

    def __init__(self, gripper: Gripper, cell: Boxes | None = None, arm: Arm = IIWA_7) -> None:
        """An arm that carries ``gripper`` in a cell of boxes, by default an empty one."""
        self.gripper, self.arm, self.cell = gripper, arm, cell or Boxes()
        self._capsules = capsule_model(arm=arm, with_hand=False)

    def hand(self, q: Array) -> Array:
        """Position of the hand at joint positions (7,) [rad], shape (3,) [m]."""
        return forward_kinematics(q, self.gripper.X_FG, self.arm)[:3, 3]

    def looked_through(self, depth: NDArray[Any], X_WC: Array, camera: Camera) -> bool | None:
        """Whether a depth image looks through the cell, by ray casting (slab method).

        What is not modeled hides the cell, but an image that shows what is behind it is not of that
        pose: it is frozen, mirrored or of another time. None where less than 3 % of the image is of
        the cell. The depth is 0 or NaN where nothing was measured, infinite where nothing is [m].
        """
        # One pixel in this number of rows and columns is compared.
        step = 8
        v, u = np.mgrid[step // 2 : camera.height : step, step // 2 : camera.width : step]
        rays = camera.rays(u.ravel(), v.ravel()) @ X_WC[:3, :3].T
        solid = np.flatnonzero(self.cell.solid)
        X_WB, half = self.cell.X_WB[solid], self.cell.half[solid, None]
        d, p_BC = rays @ X_WB[:, :3, :3], (X_WC[:3, 3] - X_WB[:, None, :3, 3]) @ X_WB[:, :3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):  # along a face, or in it
            ends = (-half - p_BC) / d, (half - p_BC) / d
        enter, leave = np.minimum(*ends).max(axis=2), np.maximum(*ends).min(axis=2)
        entered = (enter > 0.0) & (enter < leave)
        expected = np.where(entered, enter, np.inf).min(axis=0, initial=np.inf)
        measured = depth[v, u].ravel()
        # No farther than this camera measures.
        shown = (measured > 0.0) & (expected < measured[np.isfinite(measured)].max(initial=0.0))
        if np.count_nonzero(shown) < 0.03 * len(rays):
            return None
        # Errors of depth and pose are smaller; but for 3 % of the pixels, without a fault.
        return bool((measured > 1.15 * expected)[shown].mean() > 0.1)

    def kinds(
        self, points: Floats, X_WC: Array, q: Array, opening: float, noise: float
    ) -> NDArray[np.uint8]:
        """Kind of each pixel, (n,): `UNOBSERVED`, `ROBOT`, `CELL`, or `FREE` for anything else.

        Of points (n, 3) in W [m], not finite where nothing was measured, seen by a camera at X_WC
        (4, 4) with the noise `Camera.depth_noise` [1/m], at measured joint positions (7,) [rad] and
        a measured ``opening`` between the pads [m].
        """
        arm = self._capsules
        hand = hand_boxes(self.gripper, forward_kinematics(q, self.gripper.X_FG, self.arm), opening)
        kinds = np.empty(len(points), dtype=np.uint8)
        _kinds(
            np.ascontiguousarray(points, dtype=np.float32),
            np.ascontiguousarray(X_WC, dtype=float),
            SIGMAS * noise,
            (np.ascontiguousarray(arm.placed(q)), arm.radius),
            (np.ascontiguousarray(hand.X_WB), hand.half),
            (np.ascontiguousarray(self.cell.X_WB), self.cell.half),
            kinds,
        )
        return kinds


@compiled(nogil=True)
def _kinds(points, X_WC, spread, arm, hand, cell, kinds):
    """Writes the kind of each point (n, 3)."""
    lines = _lines(arm)
    for i in range(len(points)):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not np.isfinite(x + y + z):
            kinds[i] = Kind.UNOBSERVED
            continue
        depth = (
            (x - X_WC[0, 3]) * X_WC[0, 2]
            + (y - X_WC[1, 3]) * X_WC[1, 2]
            + (z - X_WC[2, 3]) * X_WC[2, 2]
        )
        margin = MARGIN + spread * depth * depth
        if _in_boxes(x, y, z, cell, margin):  # most pixels show the table
            kinds[i] = Kind.CELL
        elif _in_boxes(x, y, z, hand, margin) or _in_capsules(x, y, z, lines, arm, margin):
            kinds[i] = Kind.ROBOT
        else:
            kinds[i] = Kind.FREE


@compiled(nogil=True)
def _lines(capsules):
    """For each capsule the vector along its segment, and one over its square, (k, 4)."""
    ends, _ = capsules
    lines = np.empty((len(ends), 4))
    for k in range(len(ends)):
        square = 1e-18
        for j in range(3):
            lines[k, j] = ends[k, 1, j] - ends[k, 0, j]
            square += lines[k, j] ** 2
        lines[k, 3] = 1.0 / square
    return lines


@compiled(nogil=True)
def _in_capsules(x, y, z, lines, capsules, margin):
    ends, radius = capsules
    for k in range(len(ends)):
        a, b, c = x - ends[k, 0, 0], y - ends[k, 0, 1], z - ends[k, 0, 2]
        share = (a * lines[k, 0] + b * lines[k, 1] + c * lines[k, 2]) * lines[k, 3]
        share = min(max(share, 0.0), 1.0)
        a, b, c = a - share * lines[k, 0], b - share * lines[k, 1], c - share * lines[k, 2]
        if a * a + b * b + c * c < (radius[k] + margin) ** 2:
            return True
    return False


@compiled(nogil=True)
def _in_boxes(x, y, z, boxes, margin):
    X_WB, half = boxes
    for k in range(len(half)):
        a, b, c = x - X_WB[k, 0, 3], y - X_WB[k, 1, 3], z - X_WB[k, 2, 3]
        inside = True
        for j in range(3):
            along = a * X_WB[k, 0, j] + b * X_WB[k, 1, j] + c * X_WB[k, 2, j]
            if abs(along) > half[k, j] + margin:
                inside = False
                break
        if inside:
            return True
    return False
