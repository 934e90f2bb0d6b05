"""Writes coloured meshes as self-contained glTF 2.0 text."""

import base64
import json
from typing import Any

import numpy as np

from generator.palette import Material, color_palette, surface_palette, texel_centers
from generator.solids import Mesh, join

_FLOAT, _UINT16 = 5126, 5123
_NEAREST, _CLAMP = 9728, 33071


class _Buffer:
    """Collects arrays, and glTF's description of them."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, component: int, kind: str, **more: Any) -> int:
        """Appends an array; returns the number of its accessor."""
        self.data.extend(bytes(-len(self.data) % 4))
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        accessor = {"bufferView": len(self.views), "componentType": component}
        self.accessors.append({**accessor, "count": len(array), "type": kind, **more})
        self.views.append(view)
        self.data.extend(array.tobytes())
        return len(self.accessors) - 1


def gltf(parts: list[tuple[Material, Mesh]]) -> str:
    """One primitive with one material, in glTF's axes (y up; ours is z up).

    A renderer keeps every primitive as an object of its own and moves it at every step of a
    simulation, so the parts share one; a vertex picks its part's material out of a palette.
    Coordinates are rounded to 0.01 mm, so that the text does not depend on the machine.
    """
    materials = list(dict.fromkeys(material for material, _ in parts))
    mesh = join([mesh for _, mesh in parts])
    texel = np.repeat([materials.index(m) for m, _ in parts], [len(p.points) for _, p in parts])
    points = (np.round(mesh.points[:, [0, 2, 1]] * [1, 1, -1], 5) + 0.0).astype("<f4")
    normals = (np.round(mesh.normals[:, [0, 2, 1]] * [1, 1, -1], 3) + 0.0).astype("<f4")
    if len(points) > 65535:
        raise ValueError(f"{len(points)} vertices; an index of 16 bits numbers 65535 at most")

    buffer = _Buffer()
    bounds = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    uv = texel_centers(len(materials))[texel]
    attributes = {
        "POSITION": buffer.add(points, _FLOAT, "VEC3", **bounds),
        "NORMAL": buffer.add(normals, _FLOAT, "VEC3"),
        "TEXCOORD_0": buffer.add(uv, _FLOAT, "VEC2"),
    }
    indices = buffer.add(mesh.triangles.ravel().astype("<u2"), _UINT16, "SCALAR")
    data = base64.b64encode(buffer.data).decode()
    document = {
        "asset": {"version": "2.0", "generator": "feasigrasp models/iiwa/make_models.py"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicRoughnessTexture": {"index": 1},
                }
            }
        ],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1, "sampler": 0}],
        "images": [{"uri": color_palette(materials)}, {"uri": surface_palette(materials)}],
        "samplers": [
            {"magFilter": _NEAREST, "minFilter": _NEAREST, "wrapS": _CLAMP, "wrapT": _CLAMP}
        ],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [
            {
                "byteLength": len(buffer.data),
                "uri": f"data:application/octet-stream;base64,{data}",
            }
        ],
    }
    return json.dumps(document, separators=(",", ":")) + "\n"
