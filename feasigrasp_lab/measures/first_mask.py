"""How well the first image is segmented by its depth, against the simulation's label image."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform

from feasigrasp.models.arrays import Mask
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.robot.grippers import load_gripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import make_foreground_segmentation, make_station
from feasigrasp.systems.ports import to_value


def intersection_over_union(mask: Mask, truth: Mask) -> float:
    """Pixels in both masks as a share of those in either; 1 if both are empty."""
    either = np.count_nonzero(mask | truth)
    return np.count_nonzero(mask & truth) / either if either else 1.0


def first_mask_iou(scenario: Scenario) -> float:
    """Intersection over union of the object's first mask with its true one, in [0, 1].

    Nothing of the object is known: no field, no pose, no earlier view. Where several bodies are
    seen none is taken for it yet, since nothing has moved: 0. Pixels without a depth count
    in neither mask, since nothing is measured there.

    Args:
        scenario: Object, motion, seed, camera and its errors.
    """
    station, camera = make_station(scenario), scenario.perception.camera
    foreground = make_foreground_segmentation(scenario, load_gripper(scenario.gripper))
    at_start, context = station.CreateDefaultContext(), foreground.CreateDefaultContext()
    cloud = station.GetOutputPort(f"{camera}.point_cloud").Eval(at_start)
    for name, value in (
        ("point_cloud", cloud),
        ("camera_pose", station.GetOutputPort(f"{camera}.pose").Eval(at_start)),
        ("position", station.GetOutputPort("iiwa.position_measured").Eval(at_start)),
        ("gripper_state", station.GetOutputPort("gripper.state_measured").Eval(at_start)),
        ("object_pose", RigidTransform(np.full((3, 4), np.nan))),
        ("tracking", Tracking(TrackingState.SEARCHING, np.inf)),
        ("gpdf", to_value(None)),
        ("color_image", station.GetOutputPort(f"{camera}.color_image").Eval(at_start)),
    ):
        foreground.GetInputPort(name).FixValue(context, value)
    labels = foreground.get_output_port().Eval(context).data[:, :, 0]
    true_labels = station.GetOutputPort(f"{camera}.label_image").Eval(at_start).data[:, :, 0]
    measured = np.isfinite(cloud.xyzs()).all(axis=0).reshape(labels.shape)
    truth = true_labels == int(station.object_body.index())
    return intersection_over_union((labels == Label.OBJECT) & measured, truth & measured)
