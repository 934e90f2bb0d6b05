"""Geometric features of the neighborhood of each contact, without learned parameters.

Two things about point i that no layer acting on single points can compute, both in one pass over
pairs of points:

- `neighbourhoods`: how the surface bends, as equivariant vectors. Over the points j round a place p
  that face the way f, within each radius s,
  ``sum_j w_j n_j / W`` and ``sum_j w_j (p_j - p) / (s W)`` with
  ``w_j = (1 - |p_j - p|^2 / s^2)_+^2 (f . n_j)_+`` and ``W = sum_j w_j``.
- `hand_room`: how far the open hand would be inside the cloud if it closed on the chord of point i,
  for approach directions all round the closing axis. For each of the boxes that make up the hand,

      room = (mean_j q_j (REACH - d_ij)_+^4)^(1/4),

  d the signed Chebyshev distance of p_j from the box: nearly the deepest penetration, but smooth
  and carried by all points that come near. It depends on the hand, which is an argument.

Both are equivariant: rotating the cloud rotates the vectors; the approach directions are counted
from a reference direction that rotates along. The kernels take float32, to run, and float64, to
prove it to rounding.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Floats
from feasigrasp.models.grasps.network.surroundings_kernels import (
    HandSizes,
    neighbourhood_kernel,
    room_kernel,
)
from feasigrasp.models.robot.gripper import ParallelGripper

#: Points farther than this from a box of the hand do not count [m].
REACH = 0.025
#: Numbers that `hand_room` gives for a direction: fingers and palm, of all points and of those that
#: are sure; the way the fingers close; the camera, on the side where it has more room.
ROOM = 6
#: Clearance between the pads and a contact, below which points beside it are not in the way [m].
_PAD_CLEARANCE = 0.004


def neighbourhoods(
    centers: Floats,
    facing: Floats,
    points: Floats,
    normals: Floats,
    confidence: Floats,
    radii: tuple[float, ...],
) -> Floats:
    """Local curvature features of a surface.

    Args:
        centers: Places near the surface, shape (n, 3) [m].
        facing: Where the surface that counts faces there, unit, shape (n, 3).
        points: The surface, shape (c, 3) [m].
        normals: Its unit normals, shape (c, 3).
        confidence: How sure each of its points is, shape (c,), in [0, 1].
        radii: Of the neighbourhoods [m].

    Returns:
        For every place and radius, (n, len(radii), 8): the weight of the neighbourhood, about the
        number of points in it; and means over it: normal (3), offset in units of the radius (3),
        how sure. All zero where it is empty.
    """
    means = np.empty((len(centers), len(radii), 8), dtype=points.dtype)
    # Sorted along the longest side, so that most of the surface can be passed over.
    axis = int(np.argmax(points.max(0) - points.min(0)))
    cloud = np.concatenate([points, normals, confidence[:, None]], axis=1)
    cloud = np.ascontiguousarray(cloud[np.argsort(points[:, axis])].T)
    neighbourhood_kernel(centers, facing, cloud, np.array(radii, dtype=points.dtype), axis, means)
    return means


def hand_room(
    points: Floats,
    axes: Floats,
    across: Floats,
    widths: Floats,
    cloud: Floats,
    confidence: Floats,
    gripper: ParallelGripper,
    directions: int,
) -> Floats:
    """Penetration of the open hand into the cloud, for directions about each closing axis.

    Args:
        points: Contacts, shape (n, 3) [m].
        axes: Their closing directions into the object, unit, shape (n, 3).
        across: The approach direction of angle zero, unit and across the axis, shape (n, 3).
        widths: Distances to the contacts opposite, shape (n,) [m].
        cloud: Surface of the object, shape (c, 3) [m].
        confidence: How sure each of its points is, shape (c,), in [0, 1].
        gripper: The hand.
        directions: Their number K, even; direction k lies at the angle 2 pi k / K about the axis.

    Returns:
        Shape (`ROOM`, K, n) [m].
    """
    kind = points.dtype.type
    angle = 2.0 * np.pi * np.arange(directions) / directions
    turns = np.stack([np.cos(angle), np.sin(angle)], 1).astype(kind)
    room = np.empty((ROOM, directions, len(points)), dtype=kind)
    room_kernel(
        points,
        axes,
        across,
        kind(0.5) * widths,
        np.ascontiguousarray(cloud.T),
        confidence,
        turns,
        HandSizes(*np.array(_hand_sizes(gripper), dtype=kind)),
        kind(REACH),
        kind(1.0 / len(cloud)),
        room,
    )
    return room


def _hand_sizes(gripper: ParallelGripper) -> HandSizes:
    half = gripper.finger_thickness / 2
    length = gripper.tip - gripper.heel
    camera_y, camera_z = gripper.camera_center[1:]
    return HandSizes(
        finger_x=gripper.max_opening / 2 + half,
        finger_half_x=half,
        finger_half_y=gripper.finger_width / 2,
        finger_z=gripper.tip - length / 2,
        finger_half_z=length / 2,
        palm_half_x=gripper.palm_size[0] / 2,
        palm_half_y=gripper.palm_size[1] / 2,
        heel=gripper.heel,
        camera_half_x=gripper.camera_box[0] / 2,
        camera_y=camera_y,
        camera_half_y=gripper.camera_box[1] / 2,
        camera_top=camera_z + gripper.camera_box[2] / 2,
        clearance=_PAD_CLEARANCE,
    )
