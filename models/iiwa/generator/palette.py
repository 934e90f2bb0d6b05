"""Colours of a mesh as textures of one texel per material, so that one primitive shows them all."""

import base64
import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array

Bytes = NDArray[np.uint8]


class Material(NamedTuple):
    """A physically based material: linear RGB, and factors from 0 to 1."""

    color: tuple[float, float, float]
    metallic: float
    roughness: float


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png_row(texels: Bytes) -> str:
    """Data URI of an RGB image ``(n, 3)`` of one row.

    Its data are stored, not compressed, so that they do not depend on the version of zlib.
    """
    header = struct.pack(">IIBBBBB", len(texels), 1, 8, 2, 0, 0, 0)
    row = zlib.compress(b"\0" + texels.tobytes(), level=0)
    chunks = _chunk(b"IHDR", header) + _chunk(b"IDAT", row) + _chunk(b"IEND", b"")
    return "data:image/png;base64," + base64.b64encode(b"\x89PNG\r\n\x1a\n" + chunks).decode()


def _srgb(linear: Array) -> Array:
    """Transfer function of IEC 61966-2-1."""
    return np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def color_palette(materials: list[Material]) -> str:
    """Data URI of glTF's ``baseColorTexture``: sRGB."""
    colors = _srgb(np.array([m.color for m in materials]))
    return _png_row(np.round(255 * colors).astype(np.uint8))


def surface_palette(materials: list[Material]) -> str:
    """Data URI of glTF's ``metallicRoughnessTexture``: roughness in green, metallic in blue."""
    factors = np.array([(1.0, m.roughness, m.metallic) for m in materials])
    return _png_row(np.round(255 * factors).astype(np.uint8))


def texel_centers(number: int) -> NDArray[np.float32]:
    """Texture coordinates ``(number, 2)`` of a palette's texels."""
    u = (np.arange(number) + 0.5) / number
    return np.column_stack([u, np.full(number, 0.5)]).astype("<f4")
