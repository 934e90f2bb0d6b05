"""Inserts the faults of a scenario into a diagram."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.control import CommandFault, PerceptionLate, SolverFailure
from feasigrasp.models.faults.fault import Fault
from feasigrasp.models.faults.images import CloudFault, MaskFault
from feasigrasp.models.faults.pose import PoseFault
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.faults.faulty_command import FaultyCommand, fail_solver
from feasigrasp.systems.faults.faulty_images import FaultyCloud, FaultyMask
from feasigrasp.systems.faults.faulty_pose import FaultyPose
from feasigrasp.systems.faults.late_field import LateField
from feasigrasp.systems.grasp_controller import GraspController

_Kind = TypeVar("_Kind", bound=Fault)


@dataclass(frozen=True, eq=False)
class FaultInjection:
    """The faults of a scenario, and the builder of the diagram that gets them.

    Each is a system ``fault_<number>``, in the order of the scenario's list. Every method takes a
    port and returns the one to use instead: the same, if no fault concerns it.
    """

    builder: DiagramBuilder
    scenario: Scenario

    def cloud(
        self, cloud: OutputPort, labels: OutputPort, camera_pose: OutputPort, label: int
    ) -> OutputPort:
        """The point cloud of a camera that sees the object under ``label`` in true ``labels``."""
        for number, fault in self._of(CloudFault):
            system = FaultyCloud(fault, label, self._seed(number))
            cloud = self._insert(
                number, system, point_cloud=cloud, label_image=labels, camera_pose=camera_pose
            )
        return cloud

    def mask(self, labels: OutputPort, label: int) -> OutputPort:
        """The label image of the object, under ``label``."""
        for number, fault in self._of(MaskFault):
            labels = self._insert(number, FaultyMask(fault, label), label_image=labels)
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
            system = FaultyCommand(fault, self._seed(number))
            velocity = self._insert(number, system, velocity=velocity)
        return velocity

    def _of(self, kind: type[_Kind]) -> Iterator[tuple[int, _Kind]]:
        for number, fault in enumerate(self.scenario.faults):
            if isinstance(fault, kind):
                yield number, fault

    def _seed(self, number: int) -> int:
        return self.scenario.random_seed + 2**32 * (number + 1)

    def _insert(self, number: int, system: LeafSystem, **inputs: OutputPort) -> OutputPort:
        self.builder.AddNamedSystem(f"fault_{number}", system)
        for name, port in inputs.items():
            self.builder.Connect(port, system.GetInputPort(name))
        return system.get_output_port()
