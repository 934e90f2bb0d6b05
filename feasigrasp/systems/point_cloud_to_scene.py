"""Fuses the surroundings of the object into a scene field."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.checks import MIN_POINTS
from feasigrasp.models.clouds.edges import edge_pixels
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.observed_space import DepthView, ObservedSpace
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.capsules import arm_balls, capsule_model
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.grids import ARM_BOX, obstacle_grid
from feasigrasp.models.shape.scene_field import SceneField, fit_scene
from feasigrasp.scenario.schema import SceneConfig
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output


@dataclass(frozen=True, eq=False)
class _Surroundings(Frozen):
    """The merged views of the surroundings, in W, the space seen, and the field fitted to them."""

    cloud: FusedCloud
    space: ObservedSpace
    scene: SceneField | None = None


class PointCloudToScene(LeafSystem):
    """Fits a scene field to everything that a camera sees apart from some bodies.

    .. pydrake_system::

        name: PointCloudToScene
        input_ports: [point_cloud, label_image, camera_pose, position]
        output_ports: [scene]

    ``point_cloud`` is pixel-ordered, in the world frame W, ``label_image`` of the same camera,
    ``camera_pose`` X_WC a ``RigidTransform``; ``position`` (V7), optional, is that of the arm.
    ``scene`` is a `SceneField` in W, or None before anything was seen. Views are merged, so what
    the camera has turned away from stays; what it looks through later has gone. Space that was
    never seen and may belong to the surroundings is part of the scene (`ObservedSpace`), but for
    where the arm is or was at a look. Pixels on the edge of a surface are dropped: a real camera
    mixes the depths of two surfaces there, and what seems to stand between the hand and the table
    would hold up the arm.
    """

    def __init__(
        self,
        ignored_labels: Iterable[int],
        *,
        gripper: Gripper | None = None,
        period: float = SceneConfig.period,
        resolution: float = SceneConfig.resolution,
        arm: Arm = IIWA_7,
    ) -> None:
        """A perception of the surroundings that looks every ``period`` seconds.

        Ignored are the labels of robot and object. The arm carries the default hand if ``gripper``
        is None. The ``resolution`` is that of the scene [m].
        """
        super().__init__()
        self._ignored, self._resolution = np.array(sorted(set(ignored_labels))), resolution
        self._balls = arm_balls(capsule_model(gripper, arm))
        self._cloud = declare_input(self, "point_cloud", PointCloud())
        self._labels = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self._pose = declare_input(self, "camera_pose", RigidTransform())
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        nothing = _Surroundings(FusedCloud.empty(resolution), ObservedSpace.unknown(*ARM_BOX))
        seen = self._seen = PeriodicState(self, nothing, period, self._look)
        declare_output(self, "scene", lambda context: seen.Eval(context).scene, {seen})

    def _look(self, context: Context) -> _Surroundings:
        before: _Surroundings = self._seen.Eval(context)
        labels = self._labels.Eval(context).data[:, :, 0]
        xyz = self._cloud.Eval(context).xyzs().reshape(3, *labels.shape)
        X_WC = self._pose.Eval(context).GetAsMatrix4()
        view = DepthView.of_cloud(xyz, X_WC)
        if view is None:
            return before
        finite = np.isfinite(xyz).all(axis=0)
        surroundings = finite & ~np.isin(labels, self._ignored)
        # Points of neighbouring pixels that are farther apart lie on different surfaces [m]; those
        # of a table seen at a slant from a metre away do not.
        edges = edge_pixels(xyz, finite, surroundings, 0.05)
        points = xyz[:, surroundings & ~edges].T.astype(float)
        if len(points) < MIN_POINTS:
            points = points[:0]
        space = self._with_arm(context, before.space.seen(view, points))
        gone = view.looks_through(before.cloud.points)
        cloud = before.cloud.without(gone).merged(points, X_WC[:3, 3])
        if len(cloud.points) < MIN_POINTS:
            return _Surroundings(cloud, space)
        scene = before.scene
        if scene is None or len(points) or gone.any():
            scene = fit_scene(cloud.points, cloud.directions, resolution=self._resolution)
        scene = replace(scene, unobserved=space.hidden(cloud.points, cloud.directions))
        obstacle_grid(scene)  # now, and not in the tick of a controller that looks it up
        return _Surroundings(cloud, space, scene)

    def _with_arm(self, context: Context, space: ObservedSpace) -> ObservedSpace:
        """The space seen, and that in which the arm is with the distance that it keeps."""
        if not self._position.HasValue(context):
            return space
        center = self._balls.placed(self._position.Eval(context))
        # So much around the arm counts as free with it [m]: half of what it keeps to obstacles. If
        # it were all of it, an arm that stands before unseen space would make room for itself, look
        # by look.
        around = self._balls.radius + 0.5 * SafetyOptions.obstacle_clearance
        return space.occupied_by(center, around)
