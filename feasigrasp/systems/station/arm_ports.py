"""Ports of a station by their former names ``iiwa.*``, for one release."""

import warnings

from pydrake.systems.framework import Diagram, InputPort, OutputPort


class ArmPorts(Diagram):
    """A station whose ports ``arm.*`` are found as ``iiwa.*``, too."""

    def GetInputPort(self, port_name: str) -> InputPort:  # noqa: N802 - Drake's name
        """The input port of a name."""
        return super().GetInputPort(_present(port_name))

    def GetOutputPort(self, port_name: str) -> OutputPort:  # noqa: N802 - Drake's name
        """The output port of a name."""
        return super().GetOutputPort(_present(port_name))


def _present(name: str) -> str:
    if not name.startswith("iiwa."):
        return name
    present = name.replace("iiwa.", "arm.", 1)
    warnings.warn(f"port {name} is now {present}; rename it", FutureWarning, stacklevel=3)
    return present
