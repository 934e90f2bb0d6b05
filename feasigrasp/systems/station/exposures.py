"""Cameras whose images come late: what they see is delayed, and poses are remembered."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import GetScopedFrameByName
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort
from pydrake.systems.primitives import Demultiplexer, Multiplexer
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.kinematics import tool_pose
from feasigrasp.systems.ports import add_connected, declare_input, declare_output, weakly


class Timing(NamedTuple):
    """When a camera takes images, and how long they take, see `Exposures`: [Hz], [s], [s]."""

    fps: float
    capture_offset: float
    output_delay: float

    @classmethod
    def of(cls, camera: CameraConfig) -> Timing | None:
        """Of a camera; None if it shows what is there at every instant."""
        if camera.output_delay == camera.capture_offset == 0.0:
            return None
        return cls(camera.fps, camera.capture_offset, camera.output_delay)


class Exposures(LeafSystem):
    """Samples a vector at the exposures of a camera, and delays it as its images are.

    .. pydrake_system::

        name: Exposures
        input_ports: [u]
        output_ports: [y, stamp]

    ``y`` is ``u`` at the exposure of the present image, ``stamp`` (V1) the time of that [s]. Before
    the first image ``stamp`` is NaN, and ``y`` what the constructor was given. Image i shows the
    time ``capture_offset + i / fps``, and is there ``output_delay`` later.

    Drake's ``RgbdSensorAsync`` has the same schedule, but renders every image, supports one
    renderer only, and needs a delay shorter than the time between two images. Here the *state* that
    the renderer shows is late, so that an image is rendered only when it is read.
    """

    def __init__(self, timing: Timing, initial: Array) -> None:
        """A camera's schedule, and ``y`` (n,) before the first image."""
        super().__init__()
        self._timing, self._row = timing, 1 + len(initial)
        self._input = self.DeclareVectorInputPort("u", len(initial))
        on_their_way = math.floor(timing.output_delay * timing.fps) + 2
        self.DeclareDiscreteState(np.full(on_their_way * self._row, np.nan))
        present = self.DeclareDiscreteState(np.concatenate([[np.nan], initial]))
        period, offset = 1.0 / timing.fps, timing.capture_offset
        self.DeclarePeriodicDiscreteUpdateEvent(period, offset, weakly(self._expose))
        if timing.output_delay > 0.0:
            arrival = offset + timing.output_delay
            self.DeclarePeriodicDiscreteUpdateEvent(period, arrival, weakly(self._deliver))
        ticket = {self.discrete_state_ticket(present)}
        declare_output(self, "y", lambda context: _present(context)[1:], ticket, size=len(initial))
        declare_output(self, "stamp", lambda context: _present(context)[0], ticket, size=1)

    def _expose(self, context: Context, state) -> None:
        row = np.concatenate([[context.get_time()], self._input.Eval(context)])
        if self._timing.output_delay == 0.0:
            state.get_mutable_vector(1).SetFromVector(row)
            return
        rows = context.get_discrete_state(0).value()
        state.get_mutable_vector(0).SetFromVector(np.concatenate([row, rows[: -self._row]]))

    def _deliver(self, context: Context, state) -> None:
        """Takes the newest of the images that are due; they are kept newest first."""
        rows = context.get_discrete_state(0).value().reshape(-1, self._row)
        due = np.flatnonzero(rows[:, 0] <= context.get_time() - self._timing.output_delay + 1e-9)
        if len(due):
            state.get_mutable_vector(1).SetFromVector(rows[due[0]])


def _present(context: Context) -> Array:
    """Time and vector of the present image."""
    return context.get_discrete_state(1).value()


def add_exposures(
    builder: DiagramBuilder, name: str, timing: Timing, *sources: tuple[OutputPort, Array]
) -> tuple[list[OutputPort], OutputPort]:
    """Adds `Exposures` of some vectors: each a port, and its value before the first image.

    The systems before and after it are ``<name>_u`` and ``<name>_y``. Returned are the output ports
    with the vectors at the exposure, in order, and the one with the stamp.
    """
    sizes = [len(initial) for _, initial in sources]
    ports = (port for port, _ in sources)
    before = add_connected(builder, f"{name}_u", Multiplexer(sizes), *ports)
    exposures = Exposures(timing, np.concatenate([value for _, value in sources]))
    add_connected(builder, name, exposures, before.get_output_port())
    after = add_connected(builder, f"{name}_y", Demultiplexer(sizes), exposures.GetOutputPort("y"))
    return [after.get_output_port(k) for k in range(len(sizes))], exposures.GetOutputPort("stamp")


class FirstImage(LeafSystem):
    """Hands on the images of a camera from the first one on.

    .. pydrake_system::

        name: FirstImage
        input_ports: [image, stamp]
        output_ports: [image]

    ``stamp`` (V1) is NaN before the first image. Until then the output is ``blank``.
    """

    def __init__(self, blank: Any) -> None:
        super().__init__()
        self._blank = blank
        self._image = declare_input(self, "image", blank)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        declare_output(self, "image", self._calc, {self._image, self._stamp}, model=blank)

    def _calc(self, context: Context) -> Any:
        exposed = np.isfinite(self._stamp.Eval(context)[0])
        return self._image.Eval(context) if exposed else self._blank


class CameraPose(LeafSystem):
    """Pose of a camera that is fixed to the flange or to the world, by the arm's joints.

    .. pydrake_system::

        name: CameraPose
        input_ports: [position]
        output_ports: [pose]

    ``position`` is V7 [rad], ``pose`` X_WC a ``RigidTransform``, as the camera is calibrated.
    """

    def __init__(self, plant: MultibodyPlant, name: str, camera: CameraConfig, arm: Arm) -> None:
        """A camera by its name, on a frame of the plant, in which the arm is.

        Raises:
            ScenarioError: It is mounted neither on the flange nor in the world.
        """
        super().__init__()
        frame = GetScopedFrameByName(plant, camera.X_PB.base_frame or "world")
        flange = plant.GetFrameByName(f"{arm.name}_flange")
        self._on_arm = frame.body() in plant.GetBodiesWeldedTo(flange.body())
        if not self._on_arm and frame.body() not in plant.GetBodiesWeldedTo(plant.world_body()):
            raise ScenarioError(
                f"camera {name!r} is mounted on {camera.X_PB.base_frame!r}, which moves against "
                "the flange; mount it on the flange, on what is welded to it, or in the world"
            )
        base = flange if self._on_arm else plant.world_frame()
        X_PB = RigidTransform(camera.X_PB.GetDeterministicValue())
        X_BP = frame.CalcPose(plant.CreateDefaultContext(), base)
        self._arm = arm
        self._X_BC: Array = (X_BP @ X_PB).GetAsMatrix4()
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        declare_output(self, "pose", self._calc, {self._position}, model=RigidTransform())

    def _calc(self, context: Context) -> RigidTransform:
        if not self._on_arm:
            return RigidTransform(self._X_BC)
        q = self._position.Eval(context)
        return RigidTransform(tool_pose(np.array(q), self._X_BC, self._arm))


class _Memory(LeafSystem):
    """Remembers a row every ``period`` seconds, newest first: time [s], then ``size`` values."""

    def __init__(self, period: float, size: int) -> None:
        super().__init__()
        self._row_size = 1 + size
        count = round(0.5 / period)  # images are not older [s]
        self.DeclareDiscreteState(np.full(count * self._row_size, np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._remember))

    def _row(self, context: Context) -> Array:
        """The row of now."""
        raise NotImplementedError

    def _remember(self, context: Context, state) -> EventStatus:
        row, rows = self._row(context), context.get_discrete_state_vector().value()
        if row[0] <= rows[0]:
            return EventStatus.DidNothing()
        state.get_mutable_vector().SetFromVector(np.concatenate([row, rows[: -self._row_size]]))
        return EventStatus.Succeeded()

    def _known(self, context: Context) -> Array:
        """The rows that there are, shape (k, 1 + size)."""
        rows = context.get_discrete_state_vector().value().reshape(-1, self._row_size)
        return rows[np.isfinite(rows).all(axis=1)]


class PoseAt(_Memory):
    """Buffers poses, and returns the one at a recent time.

    .. pydrake_system::

        name: PoseAt
        input_ports: [pose, stamp]
        output_ports: [pose]

    Both poses are ``RigidTransform``; ``stamp`` is V1 [s]. Between the instants at which the pose
    was remembered it is a screw; before the first of them, and for a stamp that is NaN, it is the
    oldest that is known; after the last one, the present one.
    """

    def __init__(self, period: float) -> None:
        """Remembers the pose every ``period`` seconds."""
        super().__init__(period, 12)
        self._pose = declare_input(self, "pose", RigidTransform())
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        sources = {self.xd_ticket(), self._stamp, self._pose}
        declare_output(self, "pose", self._calc, sources, model=RigidTransform())

    def _row(self, context: Context) -> Array:
        X = self._pose.Eval(context).GetAsMatrix4()
        return np.concatenate([[context.get_time()], X[:3].ravel()])

    def _calc(self, context: Context) -> RigidTransform:
        known, stamp = self._known(context), self._stamp.Eval(context)[0]
        if len(known) == 0 or stamp > known[0, 0]:
            return RigidTransform(self._pose.Eval(context))
        return RigidTransform(_interpolated(known, stamp))


class PositionAt(_Memory):
    """As `PoseAt`, of joint positions.

    .. pydrake_system::

        name: PositionAt
        input_ports: [position, measured_at, stamp]
        output_ports: [position]

    Positions are V``n`` [rad]; ``measured_at``, when the present ones were measured, and ``stamp``
    are V1 [s]. Between two measurements positions change evenly, however far they are apart.
    """

    def __init__(self, period: float, n: int) -> None:
        """Remembers ``n`` positions every ``period`` seconds."""
        super().__init__(period, n)
        self._position = self.DeclareVectorInputPort("position", n)
        self._measured_at = self.DeclareVectorInputPort("measured_at", 1)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        sources = {self.xd_ticket(), self._stamp, self._position}
        declare_output(self, "position", self._calc, sources, size=n)

    def _row(self, context: Context) -> Array:
        return np.concatenate([self._measured_at.Eval(context), self._position.Eval(context)])

    def _calc(self, context: Context) -> ArrayLike:
        known = self._known(context)[::-1]
        position, stamp = self._position.Eval(context), self._stamp.Eval(context)[0]
        if len(known) == 0 or stamp > known[-1, 0]:
            return position
        at = known[0, 0] if np.isnan(stamp) else stamp
        return [np.interp(at, known[:, 0], values) for values in known[:, 1:].T]


def _interpolated(rows: Array, stamp: float) -> Array:
    """The pose (4, 4) at a time; the rows are newest first."""
    older = int(np.searchsorted(-rows[:, 0], -stamp))
    if older == 0 or older == len(rows) or not np.isfinite(stamp):
        return _matrix(rows[0 if older == 0 else -1])
    X_a, X_b = _matrix(rows[older]), _matrix(rows[older - 1])
    share = (stamp - rows[older, 0]) / (rows[older - 1, 0] - rows[older, 0])
    return se3.interpolate(X_a, X_b, share)


def _matrix(row: Array) -> Array:
    X = np.eye(4)
    X[:3] = row[1:].reshape(3, 4)
    return X
