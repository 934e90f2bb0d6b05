"""A depth camera of the station: renderer, sensor noise, point cloud, ports."""

from typing import NamedTuple

import numpy as np
from pydrake.geometry import RenderLabel, SceneGraph
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.perception import DepthImageToPointCloud
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.sensors import (
    ApplyCameraConfig,
    CameraConfig,
    CameraInfo,
    ImageDepth32F,
    ImageLabel16I,
    PixelType,
)

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import tool_pose
from feasigrasp.models.sensors.camera_errors import MATERIALS, CameraErrors, HandEyeError
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.systems.ports import add_connected, declare_input, declare_output, scalar
from feasigrasp.systems.station.exposures import CameraPose, FirstImage


class NoisyDepth(LeafSystem):
    """Adds a depth camera's errors to its images.

    .. pydrake_system::

        name: NoisyDepth
        input_ports: [depth_image, label_image, camera_pose, object_pose, stamp]
        output_ports: [depth_image]

    The depth images are ``ImageDepth32F`` [m]; a pixel that was lost or is too near is 0, one that
    is too far infinite. Label image and poses, X_WC and X_WO, are the true ones of the same
    instant. The errors depend on the seed, the inputs and ``stamp`` only, the time of the image
    (V1) [s], so an image that is read twice is the same twice, and a run repeats. Without a stamp
    an image is taken when it is read; with one that is NaN there has been no image, and there is
    nothing to err.
    """

    def __init__(
        self,
        noise: DepthNoise,
        info: CameraInfo,
        seed: int = 0,
        *,
        near: float = 0.0,
        far: float = np.inf,
        object_label: int = -1,
        material: str = "matt",
    ) -> None:
        """The errors of one camera, by its intrinsics; cameras with the same seed err alike.

        It measures depths from ``near`` to ``far`` [m]. The object has pixels of that label, and a
        material of `MATERIALS`.
        """
        super().__init__()
        self._noise, self._seed = noise, seed
        self._near, self._far = near, far
        self._errors = CameraErrors(noise, seed, (info.height(), info.width()))
        self._label, self._material = object_label, MATERIALS[material]
        self._intrinsics = (info.focal_x(), info.focal_y(), info.center_x(), info.center_y())
        image = ImageDepth32F(info.width(), info.height())
        self._input = declare_input(self, "depth_image", image)
        self._labels = declare_input(self, "label_image", ImageLabel16I(1, 1))
        self._camera_pose = declare_input(self, "camera_pose", RigidTransform())
        self._object_pose = declare_input(self, "object_pose", RigidTransform())
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        declare_output(self, "depth_image", self._calc, model=image)

    def _calc(self, context: Context) -> ImageDepth32F:
        image: ImageDepth32F = self._input.Eval(context)
        time = scalar(self._stamp, context, context.get_time())
        if not np.isfinite(time):
            return image
        depth = image.data[:, :, 0]
        rng = np.random.default_rng([self._seed, round(1e6 * time)])
        X_WC, X_WO = self._camera_pose.Eval(context), self._object_pose.Eval(context)
        fixed = self._errors.fixed(
            depth,
            self._intrinsics,
            (X_WC.GetAsMatrix4(), (X_WO.inverse() @ X_WC).GetAsMatrix4()),
            self._labels.Eval(context).data[:, :, 0] == self._label,
            self._material,
        )
        limits = {"near": self._near, "far": self._far}
        noisy = ImageDepth32F(image.width(), image.height())
        noisy.mutable_data[:, :, 0] = self._noise.apply(
            depth, self._intrinsics, rng, **limits, fixed=fixed
        )
        return noisy


class CalibratedPose(LeafSystem):
    """Converts the true pose of a camera to its calibrated pose.

    .. pydrake_system::

        name: CalibratedPose
        input_ports: [true_pose, position]
        output_ports: [pose]

    The poses are ``RigidTransform``, X_WC and X_WB. ``position`` V7, the true joint positions
    [rad], is for a camera on the arm: its pose is computed from encoders with zeros that err.
    """

    def __init__(self, X_CB: Array, zero: Array, arm: Arm = IIWA_7) -> None:
        """A camera with the calibrated pose ``X_CB`` (4, 4) in its own true frame.

        At zero the arm's encoders measure ``zero`` (n,) [rad].
        """
        super().__init__()
        self._X_CB, self._zero, self._arm = RigidTransform(X_CB), zero, arm
        self._pose = declare_input(self, "true_pose", RigidTransform())
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        declare_output(self, "pose", self._calc, model=RigidTransform())

    def _calc(self, context: Context) -> RigidTransform:
        X_WB = self._pose.Eval(context) @ self._X_CB
        if not self._position.HasValue(context):
            return X_WB
        q = self._position.Eval(context)
        poses = (tool_pose(p, None, self._arm) for p in (q, q + self._zero))
        flange, measured = map(RigidTransform, poses)
        return measured @ flange.inverse() @ X_WB


class Scene(NamedTuple):
    """The scene that cameras of one schedule render.

    Attributes:
        graph: What they see.
        plant: Whose frames they are mounted on.
        object_label: Of the object's pixels.
        material: Of the object.
        object_pose: Port of its pose X_WO.
        arm: The arm, which they may be on.
        position: Port of its true joint positions (V7) [rad].
        zero: What its encoders measure at zero, shape (7,) [rad].
        stamp: When it was so (V1) [s]; None for the present scene.
        measured: What was measured then, by the name of the camera's port.
    """

    graph: SceneGraph
    plant: MultibodyPlant
    object_label: int
    material: str
    object_pose: OutputPort
    arm: Arm
    position: OutputPort
    zero: Array
    stamp: OutputPort | None = None
    measured: dict[str, OutputPort] = {}


def export_camera(
    builder: DiagramBuilder,
    config: CameraConfig,
    scene: Scene,
    position: OutputPort,
    *,
    noise: DepthNoise | None,
    hand_eye: HandEyeError | None,
    seed: int,
) -> None:
    """Adds a camera and exports its outputs as ``<name>.<output>``.

    These are ``point_cloud`` (world frame, pixel by pixel), ``color_image``, ``depth_image``,
    ``label_image`` and ``pose`` X_WC. Pose and cloud are as the camera's calibration has them.
    With a ``stamp`` also that, what was measured then, and ``pose_now``, X_WC by the present
    joints; before the first image there is no depth, and nothing else, in images of the usual size.

    Args:
        builder: The builder of the station.
        config: The camera; its name becomes that of the ports.
        scene: What it sees.
        position: The present true joints (V7) [rad].
        noise: Errors of its depth image, and of the point cloud made from it; None for none.
        hand_eye: Error of its calibration; None for none.
        seed: Seed of those errors.
    """
    name, stamp = config.name, scene.stamp
    # The scene graph is late already, if images are to be.
    config.output_delay = config.capture_offset = 0.0
    # An LCM sink that goes nowhere: images are rendered only when somebody reads them.
    lcm = DrakeLcm("memq://null")
    ApplyCameraConfig(config, builder, plant=scene.plant, scene_graph=scene.graph, lcm=lcm)
    sensor = builder.GetSubsystemByName(f"rgbd_sensor_{name}")
    depth = _from_first_image(builder, sensor.depth_image_32F_output_port(), stamp)
    color = _from_first_image(builder, sensor.color_image_output_port(), stamp)
    labels = _from_first_image(builder, sensor.label_image_output_port(), stamp)
    info, true_pose = pixel_centred_intrinsics(config), sensor.body_pose_in_world_output_port()
    if noise is not None:
        errors = NoisyDepth(
            noise,
            info,
            seed,
            near=config.z_near,
            far=config.z_far,
            object_label=scene.object_label,
            material=scene.material,
        )
        true = {"depth_image": depth, "label_image": labels, "camera_pose": true_pose}
        true["object_pose"] = scene.object_pose
        if stamp is not None:
            true["stamp"] = stamp
        depth = add_connected(builder, f"{name}_noise", errors, **true).get_output_port()
    X_CB = calibration_error(hand_eye or HandEyeError(), seed)

    def calibrated(what: str, pose: OutputPort, joints: OutputPort) -> OutputPort:
        system = CalibratedPose(X_CB, scene.zero, scene.arm)
        ports = (pose, joints) if is_on_arm(config) else (pose,)
        return add_connected(builder, f"{name}_{what}", system, *ports).get_output_port()

    pose = calibrated("calibrated_pose", true_pose, scene.position)
    points = DepthImageToPointCloud(info, PixelType.kDepth32F)
    add_connected(builder, f"{name}_point_cloud", points, depth_image=depth, camera_pose=pose)
    ports = dict(scene.measured)
    if stamp is not None:
        now = CameraPose(scene.plant, name, config, scene.arm)
        add_connected(builder, f"{name}_true_pose_now", now, position)
        ports["pose_now"] = calibrated("pose_now", now.get_output_port(), position)
        ports["stamp"] = stamp
    ports["point_cloud"] = points.point_cloud_output_port()
    ports |= {"color_image": color, "depth_image": depth, "label_image": labels, "pose": pose}
    for what, port in ports.items():
        builder.ExportOutput(port, f"{name}.{what}")


def _from_first_image(
    builder: DiagramBuilder, port: OutputPort, stamp: OutputPort | None
) -> OutputPort:
    """The images of a port; without any depth or label, and black, before the first one."""
    if stamp is None:
        return port
    blank = port.Allocate().get_value()
    if isinstance(blank, ImageDepth32F):
        blank.mutable_data[:] = np.inf
    elif isinstance(blank, ImageLabel16I):
        blank.mutable_data[:] = int(RenderLabel.kEmpty)
    name = f"{port.get_system().get_name()}_{port.get_name()}"
    return add_connected(builder, name, FirstImage(blank), port, stamp).get_output_port()


def calibration_error(hand_eye: HandEyeError, seed: int) -> Array:
    """Calibrated pose of a camera in its true frame, X_CB (4, 4); drawn from a seed."""
    # Makes the seed of a calibration another than those of the images.
    return hand_eye.draw(np.random.default_rng([seed, 2**40]))


def is_on_arm(camera: CameraConfig) -> bool:
    """Whether a camera is on the arm, and not fixed in the world."""
    return camera.X_PB.base_frame not in (None, "", "world")


def pixel_centred_intrinsics(config: CameraConfig) -> CameraInfo:
    """The depth camera's intrinsics for whole-numbered pixels (u, v).

    Pixel (u, v) is rendered at its middle, (u + 1/2, v + 1/2), but turned into a point as if at
    (u, v): without this shift the cloud is half a pixel off, 0.5 mm at 0.4 m.
    """
    _, depth_camera = config.MakeCameras()
    info = depth_camera.core().intrinsics()
    center = info.center_x() - 0.5, info.center_y() - 0.5
    return CameraInfo(info.width(), info.height(), info.focal_x(), info.focal_y(), *center)
