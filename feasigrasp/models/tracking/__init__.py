"""Tracking of an object in depth images by its distance field."""

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.tracking.tracker import FieldTrack, SequenceTracker, track
from feasigrasp.models.tracking.view import ObjectView

__all__ = ["Camera", "FieldTrack", "ObjectView", "SequenceTracker", "track"]
