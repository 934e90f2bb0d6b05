"""Makes the sample capture: ``python models/capture/make_capture.py [--out FOLDER]``.

A mug on a table before the depth camera of the Reach scenarios: a RealSense D405 in its 424 x 240
mode, by ray casting, with the errors of `DepthNoise`. The folder is one that ``feasigrasp track``
reads; the output is the same on every run.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.recordings.camera_file import CameraInfo
from feasigrasp.resources import model_path
from feasigrasp_lab.training.data.raycasting import Raycaster

HERE = Path(__file__).resolve().parent
WIDTH, HEIGHT = 424, 240
#: Field of view of the depth stream [deg], and the distance between the imagers [m] (data sheet).
FIELD, BASELINE = (87.0, 58.0), 0.018
NEAR, FAR = 0.07, 3.0
#: Where the camera is, and what it looks at, over the middle of the table's top [m].
CAMERA, TARGET = np.array([0.15, -0.14, 0.2]), np.array([0.0, 0.0, 0.03])
TABLE = (0.9, 0.9, 0.02)
TABLE_COLOR, LIGHT = np.array([0.72, 0.68, 0.6]), np.array([0.3, -0.5, 0.81])


def camera_info() -> CameraInfo:
    """The camera, with the middle of the image on its axis."""
    fx, fy = (
        0.5 * size / np.tan(0.5 * np.radians(angle))
        for size, angle in zip((WIDTH, HEIGHT), FIELD, strict=True)
    )
    intrinsics = round(fx, 3), round(fy, 3), 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
    return CameraInfo(intrinsics, 1e-3, (WIDTH, HEIGHT), NEAR, BASELINE)


def camera_pose() -> np.ndarray:
    """X_WC: z forward, x level to the right, y down, shape (4, 4)."""
    z = (TARGET - CAMERA) / np.linalg.norm(TARGET - CAMERA)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return se3.make_pose(np.column_stack([x, np.cross(z, x), z]), CAMERA)


def write_capture(folder: Path) -> None:
    """Writes depth, mask, color and ``camera.json`` into a folder."""
    info, X_WC = camera_info(), camera_pose()
    mug = load_object("mug").mesh
    body = trimesh.Trimesh(mug.vertices - [0.0, 0.0, mug.vertices[:, 2].min()], mug.faces)
    table = trimesh.creation.box(TABLE)
    table.apply_translation([0.0, 0.0, -0.5 * TABLE[2]])
    scene = body + table

    fx, fy, cx, cy = info.intrinsics
    v, u = np.indices((HEIGHT, WIDTH)).reshape(2, -1)
    rays_C = np.column_stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.size)])
    starts = np.broadcast_to(X_WC[:3, 3], rays_C.shape)
    depth, face = Raycaster(scene.vertices, scene.faces).cast(starts, rays_C @ X_WC[:3, :3].T)
    hit, of_mug = np.isfinite(depth), face < len(body.faces)
    noise = DepthNoise(baseline=BASELINE)
    measured = noise.apply(
        depth.reshape(HEIGHT, WIDTH), info.intrinsics, np.random.default_rng(0), near=NEAR, far=FAR
    )
    units = np.round(np.where(np.isfinite(measured), measured, 0.0) / info.unit)

    objects = json.loads(model_path("objects", "objects.json").read_text())["objects"]
    mug_color = next(item["color"][:3] for item in objects if item["name"] == "mug")
    albedo = np.where(of_mug[:, None], mug_color, TABLE_COLOR)
    normals = np.zeros((u.size, 3))
    normals[hit] = scene.face_normals[face[hit]]
    light = 0.35 + 0.6 * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    color = np.where(hit[:, None], light[:, None] * albedo, 0.1)

    pictures = {
        "depth": units.astype(np.uint16),
        "mask": (255 * of_mug.reshape(HEIGHT, WIDTH)).astype(np.uint8),
        "color": np.round(255.0 * color).astype(np.uint8).reshape(HEIGHT, WIDTH, 3),
    }
    for name, picture in pictures.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(folder / name / "mug.png", optimize=True)
    (folder / "camera.json").write_text(info.to_json())


def main() -> None:
    """Writes the capture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write into")
    write_capture(parser.parse_args().out)


if __name__ == "__main__":
    main()
