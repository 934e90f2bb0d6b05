"""Acceptance test of a registered pose, by inliers, residuals and coverage."""

from __future__ import annotations

from feasigrasp.models.tracking.registration import Registration

#: What an image must show for its pose to be accepted: shares of the known surface that are inside
#: the image, of points on the model, of the facing model inside the image that is seen, and, at
#: most, of the facing model that projects beside the object. How much it then says is left to the
#: information: little of the object determines little.
_LEAST_INSIDE, _LEAST_INLIERS, _LEAST_COVERED, _MOST_BESIDE = 0.05, 0.6, 0.5, 0.35
#: Points of a new side are not asked to be on the model; so many of all are at least.
_LEAST_ON_MODEL = 0.45
#: Where less than this share of the known, facing surface is in the image, so many points must be
#: on the model; where hardly any is, the observed side is new, and its observed part says
#: nothing.
_LITTLE, _INLIERS_OF_LITTLE, _NEW_SIDE = 0.25, 0.7, 0.02
#: Less of the known surface than this faces a camera that sees another side.
_LEAST_FACING = 0.03
#: A pose that is not where it was expected shows such a share of the facing surface in the image,
_FOUND_VIEW = 0.3
#: and has so much of the points on the model, of the model beside the object, and of what is in
#: view seen; and if any turn was tried.
_FOUND, _FOUND_AT_ANY_ORIENTATION = (0.85, 0.1, 0.7), (0.95, 0.05, 0.8)


def is_accepted(found: Registration) -> bool:
    """Acceptance test of a pose near the expected one."""
    little = found.in_view < _LITTLE
    return (
        found.inside >= _LEAST_INSIDE
        and found.inliers >= (_INLIERS_OF_LITTLE if little else _LEAST_INLIERS)
        and found.on_model >= _LEAST_ON_MODEL
        and (found.covered >= _LEAST_COVERED or found.in_view < _NEW_SIDE)
        and found.beside <= _MOST_BESIDE
    )


def shows_model(found: Registration) -> bool:
    """Whether enough of the modeled surface is in the image."""
    return found.in_view >= _LITTLE and found.facing >= _LEAST_FACING


def is_found(found: Registration, *, any_orientation: bool = False) -> bool:
    """Acceptance test of a relocalized pose.

    Args:
        found: The pose.
        any_orientation: Whether it was searched for at all orientations, where some wrong one fits
            as well.
    """
    least_on, most_beside, least_covered = _FOUND_AT_ANY_ORIENTATION if any_orientation else _FOUND
    return (
        is_accepted(found)
        and found.facing >= _LEAST_FACING
        and found.in_view >= _FOUND_VIEW
        and found.on_model > least_on
        and found.beside < most_beside
        and found.covered >= least_covered
    )
