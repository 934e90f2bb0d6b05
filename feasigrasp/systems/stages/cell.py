"""What all stages share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort, System
from pydrake.systems.primitives import PassThrough

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.scenario.parts import Part
from feasigrasp.scenario.schema import Execution, Scenario
from feasigrasp.systems.faults.injection import FaultInjection
from feasigrasp.systems.segmentation.mask_segmentation import MaskFn
from feasigrasp.systems.stages.delay import Delay
from feasigrasp.systems.station.station import Station


@dataclass(frozen=True, eq=False)
class Cell:
    """The robot cell, the builder that holds it, and the systems that are in it by now.

    ``mask`` is the function that segments images; None for what the scenario says.
    """

    builder: DiagramBuilder
    scenario: Scenario
    gripper: ParallelGripper
    station: Station
    mask: MaskFn | None = None

    def port(self, name: str) -> OutputPort | None:
        """The station's output of that name, if it has one."""
        return self.station.GetOutputPort(name) if self.station.HasOutputPort(name) else None

    @property
    def faults(self) -> FaultInjection:
        """Where the scenario's faults come from."""
        return FaultInjection(self.builder, self.scenario)

    @property
    def simulated(self) -> bool:
        """Whether the cell is simulated, and its time with it."""
        return isinstance(self.station, Station)

    @property
    def masked(self) -> bool:
        """Whether a mask function segments images."""
        return self.mask is not None or Part.SEGMENTATION in self.scenario.parts

    @property
    def remote(self) -> bool:
        """Whether perception works in processes of its own."""
        chosen = self.scenario.perception.execution
        return chosen == Execution.PROCESSES or (chosen == Execution.AUTO and not self.simulated)

    def late(self, initial: Any) -> LeafSystem:
        """Hands on values as late as grasps are, and ``initial`` until one arrives.

        Only in simulation, inline: elsewhere what is perceived takes the time that it takes.
        """
        latency = self.scenario.perception.latency
        if self.remote or not self.simulated or latency == 0.0:
            vector = isinstance(initial, np.ndarray)
            return PassThrough(len(initial) if vector else AbstractValue.Make(initial))
        return Delay(initial, latency, self.scenario.control.period)

    def __getitem__(self, name: str) -> System:
        """The system of that name."""
        return self.builder.GetSubsystemByName(name)

    def source(self, name: str, port: str) -> OutputPort:
        """What an input port of the system of that name is connected to."""
        system = self[name]
        index = system.GetInputPort(port).get_index()
        source, number = self.builder.connection_map()[system, index]
        return source.get_output_port(number)

    def add(self, name: str, system: System, *sources: System, **inputs: OutputPort) -> System:
        """Adds a system, its inputs connected as `connect` does."""
        self.builder.AddNamedSystem(name, system)
        self.connect(system, *sources, **inputs)
        return system

    def connect(self, system: System, *sources: System, **inputs: OutputPort) -> None:
        """Connects inputs: those named as told, others to the first source with that output."""
        for port in map(system.get_input_port, range(system.num_input_ports())):
            name = port.get_name()
            for source in sources:
                if name not in inputs and source.HasOutputPort(name):
                    inputs[name] = source.GetOutputPort(name)
        for name, output in inputs.items():
            self.builder.Connect(output, system.GetInputPort(name))


def accepted(system: System, **ports: OutputPort) -> dict[str, OutputPort]:
    """Those of the ports that a system has an input for."""
    return {name: port for name, port in ports.items() if system.HasInputPort(name)}


def given(**ports: OutputPort | None) -> dict[str, OutputPort]:
    """Those of the ports that there are."""
    return {name: port for name, port in ports.items() if port is not None}
