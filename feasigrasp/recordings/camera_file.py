"""Camera files beside depth images: intrinsics and unit, in the layouts of common tools.

::

    fx, fy, cx, cy   focal lengths and principal point, for whole-numbered pixels [px]; RealSense's
                     ppx and ppy
    cam_K, K, k, camera_matrix, intrinsic_matrix, intrinsics, or the file itself
                     the matrix instead: by rows (BOP, ROS, text, NumPy) or columns (Open3D), flat
                     or nested, or {data: ...}
    depth_scale      millimetres per unit of images of whole numbers; 1 if it is not there
    width, height    optional: size of the images [px]; also image_width, image_height
    near             optional: least depth that is measured [m]
    baseline         optional: distance between the imagers of a stereo camera [m]

Of BOP's ``scene_camera.json`` the first image counts.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from feasigrasp.errors import CameraError, InputError
from feasigrasp.inputs import read_arrays, read_json
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.clouds.camera import BASELINE, Camera, stereo_deviation
from feasigrasp.models.quantities import Count, NotNegative, Positive


@dataclass(frozen=True)
class CameraInfo:
    """Intrinsics, unit and range of a depth camera.

    Attributes:
        intrinsics: fx, fy, cx, cy for whole-numbered pixels [px].
        unit: Metres per unit of its images of whole numbers; millimetres by default.
        size: Width and height of its images [px], if they are given.
        near: Least depth that it measures [m].
        baseline: Distance between its two imagers [m]; by default that of a RealSense D435.
        source: What errors call it.
    """

    intrinsics: tuple[float, float, float, float]
    unit: Positive = 1e-3
    size: tuple[Count, Count] | None = None
    near: NotNegative = 0.1
    baseline: Positive = BASELINE
    source: str = "the camera"

    def __post_init__(self) -> None:
        """Checks the figures.

        Raises:
            CameraError: A focal length, the unit or the baseline is not positive, or not finite.
        """
        mend = "give positive fx, fy, depth_scale and baseline"
        try:
            check_fields(self, CameraError)
        except CameraError as error:
            raise CameraError(f"{self.source}: {error}; {mend}") from None
        if min(self.intrinsics[:2]) <= 0.0:
            raise CameraError(f"{self.source}: intrinsics are {self.intrinsics}; {mend}")

    @checked(CameraError)
    def camera(self, width: Count, height: Count) -> Camera:
        """The camera of images of that size.

        Raises:
            CameraError: The intrinsics are those of images of another size.
        """
        fx, fy, cx, cy = self.intrinsics
        given = f"{self.source}: fx, fy, cx, cy = {fx:g}, {fy:g}, {cx:g}, {cy:g}"
        if self.size not in (None, (width, height)):
            raise CameraError(
                f"{self.source} is of images of {self.size[0]} x {self.size[1]} pixels, this one "
                f"has {width} x {height}; give the camera file of this size"
            )
        # Bounds of focal length over image width: fields of view from 3 to 136 degrees. The widest
        # depth camera in use, the Azure Kinect, has 120; normalized intrinsics are below it.
        low, high = (share * width for share in (0.2, 20.0))
        inside = -0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5
        if not (low < fx < high and low < fy < high and inside):
            raise CameraError(
                f"{given} are no intrinsics of {width} x {height} pixels; give those of this "
                "image size, in pixels"
            )
        noise = stereo_deviation(fx, self.baseline)
        return Camera(self.intrinsics, width, height, self.near, noise)

    def to_json(self) -> str:
        """The content of its ``camera.json``."""
        content = dict(zip(("fx", "fy", "cx", "cy"), self.intrinsics, strict=True))
        content |= {"depth_scale": round(1e3 * self.unit, 6)}
        content |= {} if self.size is None else {"width": self.size[0], "height": self.size[1]}
        return json.dumps(content | {"near": self.near, "baseline": self.baseline}, indent=1) + "\n"


@checked(InputError)
def read_camera(given: str | Path) -> CameraInfo:
    """Reads a camera file, or intrinsics that are given as text.

    Args:
        given: A file, see above; or ``fx,fy,cx,cy`` [px], of images in millimetres.

    Raises:
        InputError: There is no such file, or it lacks something.
        CameraError: See `CameraInfo`.
    """
    try:
        fx, fy, cx, cy = (float(number) for number in str(given).split(","))
    except ValueError:
        return _read_file(Path(given))
    return CameraInfo((fx, fy, cx, cy), source=f"intrinsics {given}")


def find_camera(folder: Path) -> Path | None:
    """The camera file in a folder, if there is one; the first of several."""
    names = (
        *("camera.json", "scene_camera.json", "intrinsics.json", "intrinsic.json"),
        *("camera_intrinsic.json", "camera_info.yaml", "camera_info.yml", "camera.yaml"),
        *("cam_K.txt", "K.txt", "intrinsics.txt", "camera-intrinsics.txt", "K.npy"),
    )
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _read_file(file: Path) -> CameraInfo:
    if not file.is_file():
        raise InputError(f"there is no file {file}; give camera.json, or the numbers fx,fy,cx,cy")
    content = _content(file)
    matrices = ("cam_K", "K", "k", "camera_matrix", "intrinsic_matrix", "intrinsics", "intrinsic")
    try:
        first = next(iter(content.values()), None) if isinstance(content, dict) else None
        if isinstance(first, dict) and "cam_K" in first:  # BOP's scene_camera.json
            content = first
        if not isinstance(content, dict):
            content = {"K": content}
        nested = next((content[n] for n in matrices if n in content), None)
        if isinstance(nested, dict) and "fx" in nested:
            content = content | nested
        names = ("ppx", "ppy") if "ppx" in content else ("cx", "cy")
        if "fx" in content:
            fx, fy, cx, cy = (float(content[name]) for name in ("fx", "fy", *names))
        elif nested is None:
            raise KeyError("fx")
        else:
            fx, fy, cx, cy = _of_matrix(nested)
        sizes = (("width", "height"), ("image_width", "image_height"))
        pair = next((pair for pair in sizes if pair[0] in content), None)
        size = None if pair is None else (int(content[pair[0]]), int(content[pair[1]]))
        scale = float(content.get("depth_scale", 1.0))
        near = float(content.get("near", CameraInfo.near))
        baseline = float(content.get("baseline", CameraInfo.baseline))
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{file}: {error!r}; give the numbers fx, fy, cx, cy [px] and depth_scale [mm per unit]"
        ) from error
    return CameraInfo((fx, fy, cx, cy), 1e-3 * scale, size, near, baseline, str(file))


def _content(file: Path) -> Any:
    """What a file holds: JSON, YAML, NumPy, or numbers as text."""
    if file.suffix == ".json":
        return read_json(file)
    if file.suffix in (".npy", ".npz"):
        arrays = read_arrays(file)
        return arrays.get("K", next(iter(arrays.values()), None))
    try:
        if file.suffix in (".yaml", ".yml"):
            return yaml.safe_load(file.read_text())
        return np.loadtxt(file)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"{file} is no camera file ({str(error).splitlines()[0]})") from error


def _of_matrix(given: Any) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a matrix by rows or columns, or of these four numbers."""
    numbers = np.asarray(given["data"] if isinstance(given, dict) else given, dtype=float).ravel()
    if len(numbers) == 4:
        fx, fy, cx, cy = numbers.tolist()
        return fx, fy, cx, cy
    K = numbers.reshape(3, -1)[:, :3] if len(numbers) in (9, 12) else numbers.reshape(4, 4)[:3, :3]
    K = K.T if K[2, 0] > 1.0 else K
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
