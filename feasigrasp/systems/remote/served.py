"""A stage outside its diagram: inputs at an instant in, changed outputs out, as bytes."""

import copyreg
import io
import pickle
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.perception import PointCloud
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import InputPort, OutputPort, PortDataType, System
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from feasigrasp.one_thread import one_thread
from feasigrasp.systems.ports import same_value

#: What is said when the stage is built and compiled.
READY = b"ready"


def main(descriptor: int) -> None:
    """Works until the other side closes the connection of that descriptor, or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever has started this
    connection = Connection(descriptor)
    with suppress(EOFError, ConnectionError):
        _serve(connection)


def _serve(connection: Connection) -> None:
    make, state = unpacked(connection.recv_bytes())
    with one_thread():
        served = Served(make())
        if state is not None:
            served.remember(state)
        connection.send_bytes(READY)
        handed_over = -np.inf
        while True:
            time, inputs = unpacked(connection.recv_bytes())
            new, state = served.looked(time, inputs), None
            # What is remembered is handed over, for whoever takes its place, no more often than
            # this [s].
            if new and time >= handed_over + 0.5:
                handed_over, state = time, served.state()
            connection.send_bytes(packed((new, state)))


def inputs_of(stage: System) -> list[InputPort]:
    """The input ports of a system."""
    return [stage.get_input_port(i) for i in range(stage.num_input_ports())]


def outputs_of(stage: System) -> list[OutputPort]:
    """The output ports of a system."""
    return [stage.get_output_port(i) for i in range(stage.num_output_ports())]


def is_vector(port: InputPort | OutputPort) -> bool:
    """Whether a port is vector-valued."""
    return bool(port.get_data_type() == PortDataType.kVectorValued)


class Served:
    """A system, and a context in which it is brought up to date now and then.

    Its outputs must follow from its abstract state, and that from periodic events, and those of
    initialization, which are at the first instant that it is given.
    """

    def __init__(self, stage: System) -> None:
        self._stage, self._simulator = stage, Simulator(stage)
        self._context = self._simulator.get_mutable_context()
        self._begun = False
        self._sent: dict[str, Any] = {}

    def outputs(self) -> dict[str, Any]:
        """The values of its output ports by name; vectors as arrays."""
        values = {port.get_name(): port.Eval(self._context) for port in outputs_of(self._stage)}
        return {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in values.items()}

    def looked(self, time: float, inputs: dict[str, Any]) -> dict[str, Any]:
        """Does what is due at a time [s] with these inputs; returns the outputs that are new."""
        for port in inputs_of(self._stage):
            if port.get_name() in inputs:
                self._fix(port, inputs[port.get_name()])
        before = self._states()
        self._context.SetTime(time)
        # The stage's events at an instant are those that are pending after this.
        begin = InitializeParams()
        begin.suppress_initialization_events = self._begun
        self._simulator.Initialize(begin)
        self._simulator.AdvancePendingEvents()
        self._begun = True
        if self._sent and all(a is b for a, b in zip(before, self._states(), strict=True)):
            return {}
        sent, self._sent = self._sent, self.outputs()
        return {k: v for k, v in self._sent.items() if not same_value(v, sent.get(k))}

    def state(self) -> bytes:
        """State of the stage."""
        return packed(self._states())

    def remember(self, state: bytes) -> None:
        """Lets it remember what another one of its kind did."""
        for i, value in enumerate(unpacked(state)):
            self._context.get_mutable_abstract_state(i).set_value(value)
        self._begun = True

    def _states(self) -> list[Any]:
        count = self._context.get_abstract_state().size()
        return [self._context.get_abstract_state(i).get_value() for i in range(count)]

    def _fix(self, port: InputPort, value: Any) -> None:
        if not is_vector(port):
            value, given = port.Allocate(), value
            value.set_value(given)
        port.FixValue(self._context, value)


_IMAGES: dict[str, Any] = {"depth": ImageDepth32F, "label": ImageLabel16I, "color": ImageRgba8U}


def packed(value: Any) -> bytes:
    """The bytes that a value travels as."""
    buffer = io.BytesIO()
    # With this protocol arrays stay read-only or writeable, which compiled functions distinguish.
    _Pickler(buffer, 5).dump(value)
    return buffer.getvalue()


def unpacked(data: bytes) -> Any:
    """The value that travelled as these bytes, which must come from a process of ours."""
    return pickle.loads(data)


def _cloud(xyzs: NDArray[np.float32]) -> PointCloud:
    cloud = PointCloud(xyzs.shape[1])
    cloud.mutable_xyzs()[:] = xyzs
    return cloud


def _image(kind: str, pixels: NDArray[Any]) -> Any:
    image = _IMAGES[kind](pixels.shape[1], pixels.shape[0])
    image.mutable_data[:] = pixels
    return image


def _read_only(mapping: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(mapping)


class _Pickler(pickle.Pickler):
    dispatch_table = copyreg.dispatch_table | {
        PointCloud: lambda cloud: (_cloud, (cloud.xyzs(),)),
        ImageDepth32F: lambda image: (_image, ("depth", image.data)),
        ImageLabel16I: lambda image: (_image, ("label", image.data)),
        ImageRgba8U: lambda image: (_image, ("color", image.data)),
        MappingProxyType: lambda mapping: (_read_only, (dict(mapping),)),
    }
