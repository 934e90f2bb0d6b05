"""Wrong values at the input ports of public systems are refused by the port's name."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem, PortDataType

import feasigrasp.systems as systems
from feasigrasp.errors import ArgumentError
from feasigrasp.models.grasps import AntipodalSampler
from feasigrasp.models.robot import ParallelGripper
from feasigrasp.systems import ports
from tests.public_arguments import Examples

PUBLIC = [
    name
    for name in systems.__all__
    if isinstance(thing := getattr(systems, name), type) and issubclass(thing, LeafSystem)
]
#: Whatever a controller of one's own remembers.
ANYTHING = {"plan"}


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    return Examples(tmp_path_factory.mktemp("examples"))


@pytest.mark.parametrize("name", PUBLIC)
def test_every_input_port_refuses_what_is_wrong(name, examples, monkeypatch):
    read_through = {}

    class Recorded(ports.ObjectInput):
        def __init__(self, port, check):
            super().__init__(port, check)
            read_through[port.get_name()] = self

    monkeypatch.setattr(ports, "ObjectInput", Recorded)
    construct, arguments = examples.call(name, getattr(systems, name))
    system = construct(**arguments)
    context = system.CreateDefaultContext()
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        if port.get_data_type() == PortDataType.kVectorValued:
            with pytest.raises(RuntimeError, match=f"input port '{port.get_name()}'"):
                port.FixValue(context, np.zeros(port.size() + 1))
            continue
        for wrong in ("a word", 3, np.zeros(6), {}):
            try:
                port.FixValue(context, Value[object](wrong))
            except RuntimeError as error:  # a type of Drake's own
                assert f"input port '{port.get_name()}'" in str(error)
            else:
                if port.get_name() not in ANYTHING:
                    with pytest.raises(ArgumentError, match=rf"{port.get_name()} of {name} "):
                        read_through[port.get_name()].Eval(context)


def test_public_systems_have_ports():
    assert len(PUBLIC) == 12


@pytest.mark.parametrize(
    ("system", "port"),
    [
        (systems.GraspSampler(AntipodalSampler()), "gpdf"),
        (systems.Metrics(ParallelGripper()), "grasps"),
    ],
)
def test_a_wrong_value_is_refused_where_the_system_reads_it(system, port):
    context = system.CreateDefaultContext()
    for i in range(system.num_input_ports()):
        if system.get_input_port(i).get_data_type() == PortDataType.kVectorValued:
            system.get_input_port(i).FixValue(context, np.zeros(system.get_input_port(i).size()))
    for pose in ("object_pose", "frame_pose"):
        if system.HasInputPort(pose):
            system.GetInputPort(pose).FixValue(context, RigidTransform())
    system.GetInputPort(port).FixValue(context, Value[object]({"a": 1}))
    with pytest.raises(ArgumentError, match=f"input port {port} of .* is a dict; give a "):
        system.get_output_port(0).Eval(context)
