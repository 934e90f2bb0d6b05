"""Writes what a camera sees into a folder that `read_depth_folder` reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import InputError, OutputError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.quantities import ArrayOf, Whole
from feasigrasp.outputs import replacing, write_text
from feasigrasp.recordings.camera_file import CameraInfo

#: zlib's quickest level: an image of 640 x 480 has to be written in less than 33 ms.
_COMPRESSION = 1


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image and the color image of the same pixels.

    Attributes:
        time: When it was taken [s].
        number: The camera's count of its images; where one is left out, an image was missed.
        depth: In the camera's unit, 0 where nothing was measured, shape (height, width).
        color: Red, green, blue, shape (height, width, 3).
    """

    time: float
    number: Whole
    depth: Annotated[NDArray[np.uint16], ArrayOf(("h", "w"), dtype=np.uint16)]
    color: Annotated[NDArray[np.uint8], ArrayOf(("h", "w", 3), dtype=np.uint8)]

    def __post_init__(self) -> None:
        """Checks what it is made of.

        Raises:
            InputError: The images have another kind, or not the same size.
        """
        check_fields(self, InputError)


def check_new_recording(folder: Path) -> None:
    """Refuses a folder that holds depth images already.

    Raises:
        OutputError: It does.
    """
    if any((folder / "depth").glob("*.png")):
        raise OutputError(f"{folder} holds depth images already; give another --out")


@checked(InputError)
def recorded(
    folder: Path, camera: CameraInfo, frames: Iterable[DepthFrame]
) -> Iterator[DepthFrame]:
    """Hands on images as they come, each when it is written.

    Whenever it ends, the folder is a whole recording: an image is named in ``depth.txt`` when its
    file is complete.

    Args:
        folder: The folder; it is made if need be.
        camera: Of which camera the images are.
        frames: The images.

    Raises:
        OutputError: It cannot be written, e.g. because the disk is full.
    """
    check_new_recording(folder)
    write_text(folder / "camera.json", camera.to_json())
    for k, frame in enumerate(frames):
        name = f"depth/{k:06d}.png"
        for file, image in ((name, frame.depth), (f"color/{k:06d}.png", frame.color)):
            with replacing(folder / file) as target:
                Image.fromarray(image).save(target, "png", compress_level=_COMPRESSION)
        try:
            with (folder / "depth.txt").open("a") as lines:
                lines.write(f"{frame.time:.6f} {name}\n")
        except OSError as error:
            raise OutputError(f"{folder / 'depth.txt'} cannot be written ({error})") from error
        yield frame
