"""Writes coloured meshes as self-contained glTF 2.0 text."""

import base64
import json
from typing import Any, NamedTuple

import numpy as np

from generator.solids import Mesh

_FLOAT, _UINT16 = 5126, 5123


class Material(NamedTuple):
    """A physically based material."""

    name: str
    color: tuple[float, float, float]
    metallic: float
    roughness: float


def gltf(parts: list[tuple[Material, Mesh]]) -> str:
    """One node with one primitive per part, in glTF's axes (y up; ours is z up).

    Coordinates are rounded to 0.01 mm, so that the text does not depend on the machine.
    """
    binary = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    primitives, materials = [], []

    def add(array: np.ndarray, component: int, kind: str, **bounds: Any) -> int:
        while len(binary) % 4:
            binary.append(0)
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        binary.extend(array.tobytes())
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": component,
                "count": array.size if kind == "SCALAR" else len(array),
                "type": kind,
                **bounds,
            }
        )
        return len(accessors) - 1

    for material, mesh in parts:
        points = (np.round(mesh.points[:, [0, 2, 1]] * [1, 1, -1], 5) + 0.0).astype("<f4")
        normals = (np.round(mesh.normals[:, [0, 2, 1]] * [1, 1, -1], 3) + 0.0).astype("<f4")
        bounds = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        attributes = {
            "POSITION": add(points, _FLOAT, "VEC3", **bounds),
            "NORMAL": add(normals, _FLOAT, "VEC3"),
        }
        indices = add(mesh.triangles.ravel().astype("<u2"), _UINT16, "SCALAR")
        primitives.append(
            {"attributes": attributes, "indices": indices, "material": len(materials)}
        )
        materials.append(
            {
                "name": material.name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*material.color, 1.0],
                    "metallicFactor": material.metallic,
                    "roughnessFactor": material.roughness,
                },
            }
        )
    data = base64.b64encode(bytes(binary)).decode()
    document = {
        "asset": {"version": "2.0", "generator": "feasigrasp models/iiwa/make_models.py"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {
                "byteLength": len(binary),
                "uri": f"data:application/octet-stream;base64,{data}",
            }
        ],
    }
    return json.dumps(document, separators=(",", ":")) + "\n"
