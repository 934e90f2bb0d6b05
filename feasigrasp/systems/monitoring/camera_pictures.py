"""Stores camera images with the segmented object as small pictures."""

import io
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydrake.systems.framework import Context, EventStatus, LeafSystem
from pydrake.systems.sensors import ImageLabel16I, ImageRgba8U

from feasigrasp.models.arrays import Mask
from feasigrasp.systems.ports import declare_input, weakly


class Picture(NamedTuple):
    """A stored picture: when it was taken [s], and the bytes of its JPEG."""

    time: float
    jpeg: bytes


class CameraPictures(LeafSystem):
    """Takes four pictures a second.

    .. pydrake_system::

        name: CameraPictures
        input_ports: [color_image, label_image]

    The pixels of one label are tinted: they are what perception takes for the object. A black image
    is left out: it is what a camera delivers before its first one.
    """

    def __init__(self, label: int) -> None:
        super().__init__()
        self._label = label
        self._color = declare_input(self, "color_image", ImageRgba8U(1, 1))
        self._labels = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self.pictures: list[Picture] = []
        self.DeclareInitializationPublishEvent(weakly(self._clear))
        self.DeclarePeriodicPublishEvent(0.25, 0.0, weakly(self._take))

    def _clear(self, context: Context) -> None:
        self.pictures.clear()

    def _take(self, context: Context) -> EventStatus:
        color = self._color.Eval(context).data[:, :, :3]
        if not color.any():
            return EventStatus.DidNothing()  # no image has come yet
        mask = self._labels.Eval(context).data[:, :, 0] == self._label
        self.pictures.append(Picture(context.get_time(), jpeg(color, mask)))
        return EventStatus.Succeeded()


def jpeg(color: NDArray[np.uint8], mask: Mask, width: int = 240) -> bytes:
    """A small picture with tinted pixels, as the bytes of a JPEG.

    Colors (h, w, 3) are tinted where the mask (h, w) is; the width is at most ``width`` [px].
    """
    tinted = color.astype(float)
    tinted[mask] += 0.45 * (np.array([255.0, 140.0, 0.0]) - tinted[mask])  # orange
    image = Image.fromarray(tinted.astype(np.uint8))
    image.thumbnail((width, width))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=60)
    return file.getvalue()
