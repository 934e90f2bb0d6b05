"""Fault injection between two systems of a diagram."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar
from unittest import mock

import daqp
import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import DepthImageToPointCloud, PointCloud
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, PixelType

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.faults.fault import (
    CommandFault,
    Fault,
    PerceptionLate,
    PoseFault,
    SolverFailure,
)
from feasigrasp.models.faults.images import CloudFault, DepthFault, MaskFault, View
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.grasp_controller import ControllerInputs, GraspController
from feasigrasp.systems.ports import (
    PeriodicState,
    add_connected,
    declare_input,
    declare_output,
    evaluate,
    weakly,
)
from feasigrasp.systems.station.camera import pixel_centred_intrinsics

_Kind = TypeVar("_Kind", bound=Fault)


class FaultySignal(LeafSystem):
    """Passes the first of its inputs on, but for a fault.

    .. pydrake_system::

        name: FaultySignal
        input_ports: [<signal>, <what the fault depends on>]
        output_ports: [<signal>]

    What is random depends on seed and time only.
    """

    def __init__(
        self, fault: Fault, models: Mapping[str, Any], change: Callable[..., Any], seed: int = 0
    ) -> None:
        """A fault of a signal, for the time that ``fault`` says.

        The models are values of the types of the inputs by name, the signal first; an array is a
        vector. ``change`` makes the faulty value from the values of the inputs and a generator of
        that seed.
        """
        super().__init__()
        self._fault, self._change, self._seed = fault, change, seed
        (signal, model), *_ = models.items()
        if isinstance(model, np.ndarray):
            self._inputs = [self.DeclareVectorInputPort(signal, len(model))]
            declare_output(self, signal, self._calc, size=len(model))
        else:
            self._inputs = [declare_input(self, name, like) for name, like in models.items()]
            declare_output(self, signal, self._calc, model=model)

    def _calc(self, context: Context) -> Any:
        if not self._fault.active(context.get_time()):
            return self._inputs[0].Eval(context)
        values = (port.Eval(context) for port in self._inputs)
        return self._change(*values, _rng(self._seed, context))


def faulty_cloud(fault: CloudFault, label: int, seed: int = 0) -> FaultySignal:
    """A fault of the pixel-ordered clouds of a camera that sees the object under ``label``."""

    def change(
        cloud: PointCloud, labels: ImageLabel16I, X_WC: RigidTransform, rng: np.random.Generator
    ) -> PointCloud:
        xyzs, on_object = cloud.xyzs().astype(float), labels.data.reshape(-1) == label
        view = View(xyzs, on_object, X_WC.translation(), X_WC.rotation().col(2))
        faulty = PointCloud(cloud.size())
        faulty.mutable_xyzs()[:] = fault.seen(view, rng)
        return faulty

    models = {"point_cloud": PointCloud(), "label_image": ImageLabel16I(1, 1)}
    return FaultySignal(fault, models | {"camera_pose": RigidTransform()}, change, seed)


def faulty_mask(fault: MaskFault, label: int) -> FaultySignal:
    """A fault of the mask of the body with that label; pixels that it loses count as the world."""

    def change(image: ImageLabel16I, rng: np.random.Generator) -> ImageLabel16I:
        labels = image.data[:, :, 0]
        of_object = labels == label
        others = np.where(of_object, 0, labels)  # what is lost has the world's label
        faulty = ImageLabel16I(image.width(), image.height())
        faulty.mutable_data[:, :, 0] = np.where(fault.mask(of_object), label, others)
        return faulty

    return FaultySignal(fault, {"label_image": ImageLabel16I(1, 1)}, change)


class FaultyDepth(LeafSystem):
    """Passes depth images on, but for a fault, of which it remembers the first.

    .. pydrake_system::

        name: FaultyDepth
        input_ports: [depth_image]
        output_ports: [depth_image]
    """

    def __init__(self, fault: DepthFault, period: float) -> None:
        """A fault of images that come every ``period`` seconds."""
        super().__init__()
        self._fault, self._input = fault, declare_input(self, "depth_image", ImageDepth32F(1, 1))
        self._first = PeriodicState(self, None, period, self._remember)
        declare_output(self, "depth_image", self._calc, model=ImageDepth32F(1, 1))

    def _remember(self, context: Context) -> Array | None:
        first: Array | None = self._first.Eval(context)
        if not self._fault.active(context.get_time()):
            return None
        return self._input.Eval(context).data.copy() if first is None else first

    def _calc(self, context: Context) -> ImageDepth32F:
        image, first = self._input.Eval(context), self._first.Eval(context)
        if first is None:
            return image
        faulty = ImageDepth32F(image.width(), image.height())
        faulty.mutable_data[:] = self._fault.depth(image.data, first)
        return faulty


def faulty_command(fault: CommandFault, joints: int, seed: int = 0) -> FaultySignal:
    """A fault of the commanded velocities of joints [rad/s]."""
    return FaultySignal(fault, {"velocity": np.zeros(joints)}, fault.command, seed)


class FaultyPose(LeafSystem):
    """Passes a measured pose on, but for a fault.

    .. pydrake_system::

        name: FaultyPose
        input_ports: [pose]
        output_ports: [pose]

    Both are ``RigidTransform`` X_WO. Earlier poses, which a fault may need, are remembered at the
    rate of the measurement. What is random depends on seed and time only.
    """

    def __init__(self, fault: PoseFault, period: float, seed: int = 0) -> None:
        """A fault of a pose that is measured every ``period`` seconds."""
        super().__init__()
        self._fault, self._seed = fault, seed
        self._input = declare_input(self, "pose", RigidTransform())
        # Discrete, as in the tracker: an abstract one would update the whole diagram.
        self._past = self.DeclareDiscreteState(np.full(16 * fault.depth(period), np.nan))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._remember))
        declare_output(self, "pose", self._calc, model=RigidTransform())

    def _remember(self, context: Context, discrete_state) -> None:
        X_WO = self._input.Eval(context).GetAsMatrix4()
        past = self._fault.remembered(context.get_time(), self._poses(context), X_WO)
        discrete_state.get_mutable_vector().SetFromVector(past.ravel())

    def _calc(self, context: Context) -> RigidTransform:
        X_WO = self._input.Eval(context)
        if not self._fault.active(context.get_time()):
            return X_WO
        rng = _rng(self._seed, context)
        measured = self._fault.measured(X_WO.GetAsMatrix4(), self._poses(context), rng)
        return RigidTransform(measured)

    def _poses(self, context: Context) -> np.ndarray:
        return context.get_discrete_state_vector().value().reshape(-1, 4, 4)


@dataclass(frozen=True, eq=False)
class _Post(Frozen):
    """While the fault is there, the field that has arrived last, and when later ones were sent."""

    late: bool = False
    arrived: Gpdf | None = None
    sent: tuple[tuple[float, Gpdf | None], ...] = ()


class LateField(LeafSystem):
    """Passes the object's field on, but late while there is a fault.

    .. pydrake_system::

        name: LateField
        input_ports: [gpdf]
        output_ports: [gpdf]

    Both are a `Gpdf` or None. What had come before the fault stays known; what is on its way when
    the fault ends has come by then. The delay is rounded up to ``period``.
    """

    def __init__(self, fault: PerceptionLate, *, period: float = 0.05) -> None:
        """A fault that is looked after every ``period`` seconds."""
        super().__init__()
        self._fault = fault
        self._input = declare_input(self, "gpdf")
        self._post = PeriodicState(self, _Post(), period, self._deliver)
        declare_output(self, "gpdf", self._calc, {self._input, self._post})

    def _deliver(self, context: Context) -> _Post:
        time, gpdf = context.get_time(), evaluate(self._input, context)
        post: _Post = self._post.Eval(context)
        if not self._fault.active(time):
            return _Post()
        if not post.late:
            return _Post(True, gpdf, ((time, gpdf),))
        sent = post.sent if gpdf is post.sent[-1][1] else (*post.sent, (time, gpdf))
        due = [i for i, (at, _) in enumerate(sent) if at <= time - self._fault.delay + 1e-9]
        if not due:
            return replace(post, sent=sent)
        return _Post(True, sent[due[-1]][1], sent[due[-1] :])

    def _calc(self, context: Context) -> Gpdf | None:
        post: _Post = self._post.Eval(context)
        return post.arrived if post.late else evaluate(self._input, context)


def fail_solver(controller: GraspController, fault: SolverFailure) -> None:
    """Lets the solver of a controller's QP give up while there is a fault.

    The solver is a library's function: while the fault is there, another stands in its place for
    the time of a command. What the controller makes of that is its own code.
    """
    velocity = controller.velocity

    def with_fault(memory: Any, inputs: ControllerInputs) -> Array:
        if not fault.active(inputs.time):
            return velocity(memory, inputs)
        with mock.patch.object(daqp, "solve", _give_up):
            return velocity(memory, inputs)

    controller.velocity = with_fault  # type: ignore[method-assign]


def _give_up(H: Array, *_: Array) -> tuple[Array, float, int, dict[str, Any]]:
    """What DAQP returns if there is no solution: exit flag -1."""
    return np.full(len(H), np.nan), np.nan, -1, {}


def _rng(seed: int, context: Context) -> np.random.Generator:
    return np.random.default_rng([seed, round(1e6 * context.get_time())])


@dataclass(frozen=True, eq=False)
class FaultInjection:
    """The faults of a scenario, and the builder of the diagram that gets them.

    Each is a system ``fault_<number>``, in the order of the scenario's list. Every method takes a
    port and returns the one to use instead: the same, if no fault concerns it.
    """

    builder: DiagramBuilder
    scenario: Scenario

    def depth(
        self, depth: OutputPort | None, cloud: OutputPort, camera_pose: OutputPort
    ) -> tuple[OutputPort | None, OutputPort]:
        """The depth images of perception's camera, and the cloud that is made of them."""
        camera = self.scenario.cameras[self.scenario.perception.camera]
        for number, fault in self._of(DepthFault):
            depth = self._insert(number, FaultyDepth(fault, 1.0 / camera.fps), depth_image=depth)
            points = DepthImageToPointCloud(pixel_centred_intrinsics(camera), PixelType.kDepth32F)
            of_view = {"depth_image": depth, "camera_pose": camera_pose}
            cloud = self._insert(f"{number}_cloud", points, **of_view)
        return depth, cloud

    def cloud(
        self, cloud: OutputPort, labels: OutputPort, camera_pose: OutputPort, label: int
    ) -> OutputPort:
        """The point cloud of a camera that sees the object under ``label`` in true ``labels``."""
        for number, fault in self._of(CloudFault):
            system = faulty_cloud(fault, label, self._seed(number))
            inputs = {"point_cloud": cloud, "label_image": labels, "camera_pose": camera_pose}
            cloud = self._insert(number, system, **inputs)
        return cloud

    def mask(self, labels: OutputPort, label: int) -> OutputPort:
        """The label image of the object, under ``label``."""
        for number, fault in self._of(MaskFault):
            labels = self._insert(number, faulty_mask(fault, label), label_image=labels)
        return labels

    def pose(self, pose: OutputPort) -> OutputPort:
        """The pose that the tracker measures."""
        for number, fault in self._of(PoseFault):
            system = FaultyPose(fault, self.scenario.tracker.period, self._seed(number))
            pose = self._insert(number, system, pose=pose)
        return pose

    def field(self, gpdf: OutputPort) -> OutputPort:
        """The field that perception has fitted."""
        for number, fault in self._of(PerceptionLate):
            gpdf = self._insert(number, LateField(fault), gpdf=gpdf)
        return gpdf

    def command(self, controller: LeafSystem) -> OutputPort:
        """The velocity that a controller commands.

        Raises:
            ScenarioError: The solver is to fail, and the controller is one that has none.
        """
        for _, failure in self._of(SolverFailure):
            if not isinstance(controller, GraspController):
                raise ScenarioError(
                    f"!SolverFailure needs a GraspController; {type(controller).__name__} has no "
                    "solver that could fail"
                )
            fail_solver(controller, failure)
        velocity = controller.GetOutputPort("commanded_velocity")
        for number, fault in self._of(CommandFault):
            system = faulty_command(fault, velocity.size(), self._seed(number))
            velocity = self._insert(number, system, velocity=velocity)
        return velocity

    def _of(self, kind: type[_Kind]) -> Iterator[tuple[int, _Kind]]:
        for number, fault in enumerate(self.scenario.faults):
            if isinstance(fault, kind):
                yield number, fault

    def _seed(self, number: int) -> int:
        return self.scenario.random_seed + 2**32 * (number + 1)

    def _insert(self, number: int | str, system: LeafSystem, **inputs: OutputPort) -> OutputPort:
        return add_connected(self.builder, f"fault_{number}", system, **inputs).get_output_port()
