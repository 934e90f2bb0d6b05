"""A stereo camera smears at a silhouette; neither image nor cloud keep what is in between."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import gaussian_filter, uniform_filter

from feasigrasp.models.clouds.camera import unproject
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps import perceive
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.segmentation.tabletop import tabletop
from feasigrasp.recordings import captured_points
from feasigrasp_lab.training.data.raycasting import Raycaster

WIDTH, HEIGHT, F = 640, 480, 600.0
BRICK = trimesh.creation.box((0.14, 0.06, 0.09))


def smeared_scene(body):
    """Depths of a body on a table 25 cm before a wall; disparities are means over 9 pixels [m]."""
    K = np.array([[F, 0, 320.0], [0, F, 240.0], [0, 0, 1.0]])
    mesh = body.copy()
    mesh.apply_translation([0.0, 0.0, -mesh.bounds[0, 2]])
    tilt = np.deg2rad(35.0)
    z = np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    R_WC = np.stack([[1.0, 0.0, 0.0], np.cross(z, [1.0, 0.0, 0.0]), z], axis=1)
    X_CW = se3.inverse(se3.make_pose(R_WC, [0.0, 0.0, 0.045] - 0.6 * z))
    table, wall = trimesh.creation.box((1.2, 1.2, 0.02)), trimesh.creation.box((1.2, 0.02, 1.0))
    table.apply_translation([0.0, 0.0, -0.01])
    wall.apply_translation([0.0, 0.25, 0.5])
    behind = table + wall
    casters = (Raycaster(of.vertices, of.faces) for of in (mesh, behind))
    body_depth, rest = (caster.depth_image(K, X_CW, WIDTH, HEIGHT) for caster in casters)
    disparity = F * 0.05 / np.where(np.isfinite(rest), np.minimum(body_depth, rest), 2.0)
    noise = gaussian_filter(np.random.default_rng(0).standard_normal(disparity.shape), 1.0)
    disparity = uniform_filter(disparity, 9) + 0.24 * noise
    return F * 0.05 / (np.round(32.0 * disparity) / 32.0), body_depth < rest, R_WC


@pytest.mark.parametrize("name", ["brick", "mug"])
@pytest.mark.parametrize("how", ["mask", "table", "cloud"])
def test_a_jump_in_depth_does_not_lengthen_the_object(name, how, tmp_path):
    body = BRICK if name == "brick" else load_object("mug").mesh
    depth, mask, R_WC = smeared_scene(body)
    Image.fromarray(np.round(1e4 * depth).astype(np.uint16)).save(tmp_path / "d.png")
    Image.fromarray(mask.astype(np.uint8)).save(tmp_path / "m.png")
    content = {"fx": F, "fy": F, "cx": 320.0, "cy": 240.0, "depth_scale": 0.1}
    (tmp_path / "camera.json").write_text(json.dumps(content))
    table = None
    if how == "mask":
        points = captured_points(tmp_path / "d.png", mask=tmp_path / "m.png")
    else:
        points = captured_points(tmp_path / "d.png")
        if how == "cloud":
            points = unproject(depth, (F, F, 320.0, 240.0)).reshape(3, -1).T
        standing, table = tabletop(points)
        points = points[standing]
    found = perceive(points, table=table, sampler="antipodal")
    size = np.ptp(found.gpdf.completion.points @ R_WC.T, axis=0)
    assert size.max() == pytest.approx(body.extents.max(), rel=0.12)
