"""Serialization of port values between processes, Drake's clouds and images included."""

import copyreg
import io
import pickle
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.perception import PointCloud
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

_IMAGES: dict[str, Any] = {
    "depth": ImageDepth32F,
    "label": ImageLabel16I,
    "color": ImageRgba8U,
}


def packed(value: Any) -> bytes:
    """The bytes that a value travels as."""
    buffer = io.BytesIO()
    # With this protocol arrays stay read-only or writeable, which compiled functions distinguish.
    _Pickler(buffer, 5).dump(value)
    return buffer.getvalue()


def unpacked(data: bytes) -> Any:
    """The value that travelled as these bytes, which must come from a process of ours."""
    return pickle.loads(data)


def _cloud(xyzs: NDArray[np.float32]) -> PointCloud:
    cloud = PointCloud(xyzs.shape[1])
    cloud.mutable_xyzs()[:] = xyzs
    return cloud


def _image(kind: str, pixels: NDArray[Any]) -> Any:
    image = _IMAGES[kind](pixels.shape[1], pixels.shape[0])
    image.mutable_data[:] = pixels
    return image


def _read_only(mapping: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(mapping)


class _Pickler(pickle.Pickler):
    dispatch_table = copyreg.dispatch_table | {
        PointCloud: lambda cloud: (_cloud, (cloud.xyzs(),)),
        ImageDepth32F: lambda image: (_image, ("depth", image.data)),
        ImageLabel16I: lambda image: (_image, ("label", image.data)),
        ImageRgba8U: lambda image: (_image, ("color", image.data)),
        MappingProxyType: lambda mapping: (_read_only, (dict(mapping),)),
    }
