"""Exposures of a camera whose images come late: what it sees is sampled, and delayed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import GetScopedFrameByName
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort
from pydrake.systems.primitives import Demultiplexer, Multiplexer
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems.ports import declare_input, declare_output, weakly


class Timing(NamedTuple):
    """When a camera takes images, and how long they take, as ``RgbdSensorAsync`` has it.

    Attributes:
        fps: Exposures in a second [Hz].
        capture_offset: Time of the first one [s].
        output_delay: From an exposure until its image is there [s].
    """

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

    def _expose(self, context: Context, state) -> EventStatus:
        row = np.concatenate([[context.get_time()], self._input.Eval(context)])
        if self._timing.output_delay == 0.0:
            state.get_mutable_vector(1).SetFromVector(row)
            return EventStatus.Succeeded()
        rows = context.get_discrete_state(0).value()
        state.get_mutable_vector(0).SetFromVector(np.concatenate([row, rows[: -self._row]]))
        return EventStatus.Succeeded()

    def _deliver(self, context: Context, state) -> EventStatus:
        """Takes the newest of the images that are due; they are kept newest first."""
        rows = context.get_discrete_state(0).value().reshape(-1, self._row)
        due = np.flatnonzero(rows[:, 0] <= context.get_time() - self._timing.output_delay + 1e-9)
        if len(due):
            state.get_mutable_vector(1).SetFromVector(rows[due[0]])
        return EventStatus.Succeeded()


def _present(context: Context) -> Array:
    """Time and vector of the present image."""
    return context.get_discrete_state(1).value()


def add_exposures(
    builder: DiagramBuilder, name: str, timing: Timing, *sources: tuple[OutputPort, Array]
) -> tuple[list[OutputPort], OutputPort]:
    """Adds `Exposures` of some vectors.

    Args:
        builder: The builder.
        name: Of the system; those before and after it are ``<name>_u`` and ``<name>_y``.
        timing: The camera's schedule.
        sources: Each an output port, and its value before the first image.

    Returns:
        Output ports with the vectors at the exposure, in order, and one with the stamp.
    """
    sizes = [len(initial) for _, initial in sources]
    before = builder.AddNamedSystem(f"{name}_u", Multiplexer(sizes))
    for k, (source, _) in enumerate(sources):
        builder.Connect(source, before.get_input_port(k))
    initial = np.concatenate([value for _, value in sources])
    exposures = builder.AddNamedSystem(name, Exposures(timing, initial))
    after = builder.AddNamedSystem(f"{name}_y", Demultiplexer(sizes))
    builder.Connect(before.get_output_port(), exposures.get_input_port())
    builder.Connect(exposures.GetOutputPort("y"), after.get_input_port())
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
        """Images of the size and type of ``blank``."""
        super().__init__()
        self._blank = blank
        self._image = declare_input(self, "image", blank)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        tickets = {self._image.ticket(), self._stamp.ticket()}
        declare_output(self, "image", self._calc, tickets, model=blank)

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
        context = plant.CreateDefaultContext()
        X_PB = RigidTransform(camera.X_PB.GetDeterministicValue())
        X_BP = frame.CalcPose(context, base)
        self._arm = arm
        self._X_BC: Array = (X_BP @ X_PB).GetAsMatrix4()
        self._position = self.DeclareVectorInputPort("position", arm.joints)
        ticket = {self._position.ticket()}
        declare_output(self, "pose", self._calc, ticket, model=RigidTransform())

    def _calc(self, context: Context) -> RigidTransform:
        if not self._on_arm:
            return RigidTransform(self._X_BC)
        q = self._position.Eval(context)
        return RigidTransform(forward_kinematics(np.array(q), self._X_BC, self._arm))
