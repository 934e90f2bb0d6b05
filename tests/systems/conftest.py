"""Systems under test with fixed inputs, and the animation of a Meshcat replay."""

import base64
import inspect
import itertools
import re
import struct
from collections.abc import Callable
from typing import Any

import pytest
import yaml
from pydrake.systems.framework import Context, PortDataType, System

from feasigrasp.systems.ports import to_value

#: Meshcat path -> property -> keyframes as (frame, value).
Animation = dict[str, dict[str, list[tuple[float, Any]]]]


@pytest.fixture(scope="session")
def fixed_context() -> Callable[..., Context]:
    """``fixed_context(system, **inputs)``: a default context with its input ports fixed."""
    return _fixed_context


def _fixed_context(system: System, **inputs: Any) -> Context:
    context = system.CreateDefaultContext()
    for name, value in inputs.items():
        fixed = to_value(None) if value is None else value
        system.GetInputPort(name).FixValue(context, fixed)
    return context


@pytest.fixture(scope="session")
def ports() -> Callable[[System], tuple[dict[str, int | None], dict[str, int | None]]]:
    """``ports(system)``: inputs and outputs by name, with their sizes; None if abstract."""
    return _ports


def _ports(system: System) -> tuple[dict[str, int | None], dict[str, int | None]]:
    def sizes(all_ports: list[Any]) -> dict[str, int | None]:
        return {
            port.get_name(): (
                port.size() if port.get_data_type() == PortDataType.kVectorValued else None
            )
            for port in all_ports
        }

    return (
        sizes([system.get_input_port(i) for i in range(system.num_input_ports())]),
        sizes([system.get_output_port(i) for i in range(system.num_output_ports())]),
    )


@pytest.fixture(scope="session")
def documented_ports() -> Callable[[type], tuple[list[str], list[str]]]:
    """``documented_ports(cls)``: input and output names in a docstring's pydrake_system block."""
    return _documented_ports


def _documented_ports(cls: type) -> tuple[list[str], list[str]]:
    block = inspect.getdoc(cls).split(".. pydrake_system::")[1]
    indented = itertools.takewhile(lambda line: not line or line[0] == " ", block.splitlines())
    described = yaml.safe_load("\n".join(indented))
    return described.get("input_ports", []), described.get("output_ports", [])


@pytest.fixture
def read_animation() -> Callable[[str], Animation]:
    """Gets the keyframes of a recording out of its HTML."""
    return _read_animation


def _read_animation(html: str) -> Animation:
    for encoded in re.findall(r'data:application/octet-binary;base64,([^"]*)"', html):
        data = base64.b64decode(encoded)
        if b"set_animation" not in data[:64]:
            continue
        message, _ = _unpack(data, 0)
        return {
            animation["path"]: {
                track["name"].removeprefix("."): [(k["time"], k["value"]) for k in track["keys"]]
                for track in animation["clip"]["tracks"]
            }
            for animation in message["animations"]
        }
    raise AssertionError("the replay holds no animation")


def _unpack(data: bytes, i: int) -> tuple[Any, int]:
    """One MessagePack value at offset i, and the offset behind it."""
    tag = data[i]
    i += 1
    if tag < 0x80 or tag >= 0xE0:  # a small integer
        return (tag if tag < 0x80 else tag - 0x100), i
    if tag in _CONSTANTS:
        return _CONSTANTS[tag], i
    if tag < 0xC0:
        kind = dict if tag < 0x90 else list if tag < 0xA0 else str
        size = tag & (0x1F if kind is str else 0x0F)
    else:
        kind, code = _CODES[tag]
        (size,) = struct.unpack_from(code, data, i)
        i += struct.calcsize(code)
    if kind is float:
        return size, i
    if kind is str:
        return data[i : i + size].decode(), i + size
    items = []
    for _ in range(2 * size if kind is dict else size):
        item, i = _unpack(data, i)
        items.append(item)
    return (dict(zip(items[::2], items[1::2], strict=True)) if kind is dict else items), i


_CONSTANTS = {0xC0: None, 0xC2: False, 0xC3: True}
#: What a tag announces, and how the number that follows is coded: the value itself, or a size.
_SIZED = ((str, "B"), (str, "H"), (str, "I"), (list, "H"), (list, "I"), (dict, "H"), (dict, "I"))
_CODES = {0xCA + k: (float, f">{code}") for k, code in enumerate("fdBHIQbhiq")}
_CODES |= {0xD9 + k: (kind, f">{code}") for k, (kind, code) in enumerate(_SIZED)}
