"""Shape models: Gaussian process distance fields."""

from feasigrasp.models.shape.completion import CompletedField, complete_shape
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf
from feasigrasp.models.shape.scene_field import SceneField, fit_scene

__all__ = ["CompletedField", "Gpdf", "SceneField", "complete_shape", "fit_gpdf", "fit_scene"]
