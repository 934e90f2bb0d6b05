"""The measure of equivariance, on the trained networks."""

import numpy as np
import pytest

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp_lab.measures.grasps import equivariance_error
from feasigrasp_lab.paper.grasp_network import NETWORKS, trained_network


@pytest.mark.parametrize("preset", NETWORKS)
def test_answers_move_with_the_object_up_to_rounding(preset):
    shape = sphere_points(200, 0.03) * [1.0, 0.8, 1.5] + [0.0, 0.1, 0.0]
    surface = grasp_input(fit_gpdf(shape, viewpoint=np.array([0.0, 0.0, 0.5])), 64)
    assert equivariance_error(trained_network(preset), surface, 0) < 1e-9
