"""Checks the keys of a scenario's YAML: existence, uniqueness and type.

Drake's own reader takes the last of several equal keys, names no section, and ends in assertions
where a section is no section; the text is looked at before it is read.
"""

import dataclasses as dc
import types
import typing
import warnings
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import yaml
from pydrake.systems.analysis import GetIntegrationSchemes

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import PLACE, TURN, Span, nearest

_TAG = "tag:yaml.org,2002:"
#: What a mapping holds.
_Entries = list[tuple[yaml.Node, yaml.Node]]
#: Mappings whose keys are names of the user's own.
_NAMED = (("cameras",), ("camera_noise",), ("cell", "boxes"), ("cell", "meshes"))
#: Keys that older releases of Drake have, and their value there by default; recorded scenarios hold
#: them.
_FORMER = {("simulator_config", "publish_every_time_step"): "false"}
#: Keys with a new name, which the former name stands for until the next release.
_RENAMED = {("control", "look_ahead"): "prediction", ("reachability", "twins"): "symmetric_grasps"}
#: Keys of older releases that are ``options`` of their section now, and what they are without.
_MOVED: dict[str, dict[str, object]] = {
    "control": {
        "law": "preconditioned",
        "damping": 0.02,
        "targets": "medoids",
        "length_scale": 0.0,
        "resample": False,
        "gain": None,
        "feed_forward": True,
        "n_solutions": 64,
        "source": "closed_form",
    },
    "reachability": {"space": "default", "horizon": 1.0},
}
#: What Drake's structs for things drawn from the seed call their numbers: those of one key.
_DRAWN = ("min", "max", "mean", "stddev", "value", "values")
_SCALARS = {float: "a number", int: "a whole number", bool: "true or false", str: "a word"}


def members(kind: typing.Any) -> dict[str, typing.Any]:
    """The fields of a dataclass or of one of Drake's structs, by name; none of anything else."""
    if dc.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return {field.name: hints[field.name] for field in dc.fields(kind)}
    return {field.name: field.type for field in getattr(kind, "__fields__", ())}


def general(path: Iterable[str]) -> str:
    """The dotted key of names that lead to a value, with ``*`` for a name of the user's own.

    The numbers of a distribution have the key of what is drawn.
    """
    names = list(path)
    for named in _NAMED:
        if len(names) > len(named) and names[: len(named)] == [*named]:
            names[len(named)] = "*"
    return ".".join(str(name) for name in names if name not in _DRAWN)


def find(root: yaml.Node, *path: str) -> yaml.Node | None:
    """The node that keys of a tree lead to, merged ones as well; None if it gives none."""
    if not path:
        return root
    found = None
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.value == path[0]:
            return find(value, *path[1:])
        if key.tag == f"{_TAG}merge":
            found = find(value, *path)
    return found


def replace_former_keys(root: yaml.Node, defaults: typing.Any) -> None:
    """Renames former keys of a scenario, with a warning; drops those that Drake no longer has.

    Those that are options now change the options of the scenario ``defaults``.
    """
    for section, node in _sections(root):
        node.value = [
            (k, v) for k, v in node.value if _FORMER.get((section, k.value), ...) != v.value
        ]
        for k, _ in node.value:
            if new := _RENAMED.get((section, k.value)):
                warnings.warn(
                    f"{section}.{k.value} is now {section}.{new}; rename the key (line "
                    f"{k.start_mark.line + 1}), the next release does not read it",
                    FutureWarning,
                    stacklevel=2,
                )
                k.value = new
        if section in _MOVED:
            _move(node, _MOVED[section], getattr(defaults, section).options)


def _sections(root: yaml.Node) -> Iterator[tuple[str, yaml.MappingNode]]:
    """Name and mapping of every section of a tree, merged ones as well."""
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.tag == f"{_TAG}merge":
            yield from _sections(value)
        elif isinstance(value, yaml.MappingNode):
            yield key.value, value


def _move(
    section: yaml.MappingNode, former: dict[str, object], options: dict[str, typing.Any]
) -> _Entries:
    """Moves the keys of a mapping, and of those that it merges; returns what its options are."""
    merged, own, rest = _Entries(), _Entries(), _Entries()
    found: _Entries | None = None
    for key, value in section.value:
        if key.tag == f"{_TAG}merge" and isinstance(value, yaml.MappingNode):
            merged = _move(value, former, options)
        if key.value == "options" and isinstance(value, yaml.MappingNode):
            found = value.value
        elif key.value not in former:
            rest.append((key, value))
        elif key.value in options or yaml.safe_load(yaml.serialize(value)) != former[key.value]:
            own.append((key, value))
    if own:
        given = {key.value for key, _ in (*own, *(found or ()))}
        found = [entry for entry in merged if entry[0].value not in given] + own + (found or [])
    if found is not None:
        mark = section.start_mark, section.end_mark
        word = yaml.ScalarNode(f"{_TAG}str", "options", *mark)
        rest.append((word, yaml.MappingNode(f"{_TAG}map", found, *mark)))
    section.value = rest
    return merged if found is None else found


def check_keys(node: yaml.Node, kind: typing.Any, path: tuple[str, ...] = ()) -> None:
    """Checks that a tree has keys of the schema only, with values of the kinds that it asks for.

    Args:
        node: Tree of `feasigrasp.inputs.compose_yaml`, or a part of it.
        kind: The dataclass, or the type of the part.
        path: Names that lead to the part.

    Raises:
        ScenarioError: An unknown key (with the nearest known one), or a value of another kind.
    """
    of, (kind, given) = typing.get_args(kind), _chosen(kind, node)
    shown = ".".join(path) or "the scenario"
    where = f"(line {node.start_mark.line + 1})"
    structs = [_tag(each) for each in of if _is_struct(each)]

    def expect(fits: bool, what: str) -> None:
        if not fits:
            raise ScenarioError(f"{shown} is {_text(node)}; give {what} {where}")

    if kind is None and structs and not node.tag.startswith(_TAG):
        tags = ", ".join(structs[len(structs) == len(of) :])  # the first of several needs none
        raise ScenarioError(f"{shown} has the tag {node.tag}; give {tags}, or none {where}")
    if kind in _SCALARS:
        expect(_is_scalar(node, kind), _SCALARS[kind])
    elif fields := members(kind):
        expect(isinstance(node, yaml.MappingNode), f"keys of {', '.join(fields)}")
        if not given and not node.tag.startswith(_TAG):
            raise ScenarioError(f"{shown} has the tag {node.tag}; leave it out {where}")
        for key, value in node.value:
            name = key.value
            if key.tag == f"{_TAG}merge":
                for part in value.value if isinstance(value, yaml.SequenceNode) else (value,):
                    check_keys(part, kind, path)
            elif name not in fields:
                raise ScenarioError(
                    f"{shown} has no key {name!r} (line {key.start_mark.line + 1})"
                    f"{nearest(name, fields) or '.'} It has {', '.join(fields)}"
                )
            else:
                check_keys(value, fields[name], (*path, name))
                _check_length(value, kind, name, path)
    elif _is_struct(kind):
        what = f"{node.tag} {{}}" if given else f"one of {', '.join(structs)}"
        expect(isinstance(node, yaml.MappingNode), what)
    elif typing.get_origin(kind) is dict:
        expect(isinstance(node, yaml.MappingNode), "names with values")
        for key, value in node.value:
            if key.tag != f"{_TAG}merge":
                check_keys(value, typing.get_args(kind)[1], (*path, key.value))
    elif kind is np.ndarray or typing.get_origin(kind) is list:
        expect(isinstance(node, yaml.SequenceNode), "a list")
        for i, value in enumerate(node.value):
            each = next(iter(typing.get_args(kind)), float)
            check_keys(value, each, (*path[:-1], f"{path[-1]}[{i}]"))


def _check_length(node: yaml.Node, kind: typing.Any, name: str, path: tuple[str, ...]) -> None:
    """Checks that a vector of one of Drake's structs has as many entries as the struct takes."""
    usual = None if dc.is_dataclass(kind) else getattr(kind(), name)
    if isinstance(usual, np.ndarray) and isinstance(node, yaml.SequenceNode):
        try:
            setattr(kind(), name, np.zeros(len(node.value)))
        except (TypeError, RuntimeError) as error:
            raise ScenarioError(
                f"{'.'.join((*path, name))} has {len(node.value)} entries; give {len(usual)} "
                f"(line {node.start_mark.line + 1})"
            ) from error


def _is_struct(kind: typing.Any) -> bool:
    """Whether a kind is a dataclass or one of Drake's structs, which may have no fields."""
    return dc.is_dataclass(kind) or (hasattr(kind, "__fields__") and kind.__name__[0] != "_")


def _tag(kind: typing.Any) -> str:
    """The tag of a kind; of a template, without its parameters."""
    return "!" + getattr(kind, "__name__", "").partition("𝓣")[0]


def _chosen(kind: typing.Any, node: yaml.Node) -> tuple[typing.Any, bool]:
    """Of several kinds the one that the tag names, else the first; and whether a tag named it."""
    if typing.get_origin(kind) not in (typing.Union, types.UnionType):
        return kind, False
    kinds = typing.get_args(kind)
    if type(None) in kinds and node.tag == f"{_TAG}null":
        return None, False
    if named := [k for k in kinds if _tag(k) == node.tag]:
        return named[0], True
    if all(k in _SCALARS for k in kinds):  # any single value will do
        return next((k for k in kinds if _is_scalar(node, k)), kinds[-1]), False
    return kinds[0] if node.tag.startswith(_TAG) else None, False  # Drake's reader lists the tags


def _is_scalar(node: yaml.Node, kind: type) -> bool:
    """Whether a node is a single value of a kind; ``1e-3``, which YAML takes for a word, too."""
    if not isinstance(node, yaml.ScalarNode):
        return False
    tag = node.tag.removeprefix(_TAG)
    if kind in (float, int) and tag == "str":
        try:
            kind(node.value)
        except ValueError:
            return False
        return True
    allowed = {float: ("float", "int"), int: ("int",), bool: ("bool",), str: ("str",)}
    return tag in allowed[kind]


def _text(node: yaml.Node) -> str:
    if isinstance(node, yaml.ScalarNode):
        return node.value or "empty"
    return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"


# Valid values of the keys of Drake's own schemas, as `feasigrasp.models.choices` has ours.
_ROTATION = {"rotation.deg": TURN, "rotation.angle_deg": TURN, "rotation.axis": Span(-1e3, 1e3)}

#: Least and greatest value of numbers by key; ``*`` is any name.
SPANS: dict[str, Span] = {
    **{f"object.{key}": span for key, span in _ROTATION.items()},
    "simulator_config.max_step_size": Span(1e-5, 1.0, "s"),
    "simulator_config.accuracy": Span(1e-10, 0.1),
    "simulator_config.start_time": Span(0.0, 0.0, "s"),
    "simulator_config.target_realtime_rate": Span(0.0, 100.0),
    "plant_config.time_step": Span(1e-5, 0.02, "s"),
    "plant_config.penetration_allowance": Span(1e-6, 0.1, "m"),
    "plant_config.stiction_tolerance": Span(1e-7, 0.1, "m/s"),
    "plant_config.sap_near_rigid_threshold": Span(0.0, 10.0),
    "cameras.*.width": Span(16, 4096, "px"),
    "cameras.*.height": Span(16, 4096, "px"),
    "cameras.*.focal.x": Span(1.0, 1e5, "px or deg"),
    "cameras.*.focal.y": Span(1.0, 1e5, "px or deg"),
    "cameras.*.center_x": Span(0.0, 4096.0, "px"),
    "cameras.*.center_y": Span(0.0, 4096.0, "px"),
    "cameras.*.clipping_near": Span(0.001, 10.0, "m"),
    "cameras.*.clipping_far": Span(0.01, 1e4, "m"),
    "cameras.*.z_near": Span(0.001, 10.0, "m"),
    "cameras.*.z_far": Span(0.01, 100.0, "m"),
    "cameras.*.background.rgba": Span(0.0, 1.0),
    "cameras.*.fps": Span(0.1, 1000.0, "Hz"),
    "cameras.*.capture_offset": Span(0.0, 10.0, "s"),
    "cameras.*.output_delay": Span(0.0, 0.4, "s"),  # of half a second, poses are remembered
    **{
        f"cameras.*.{frame}.{key}": span
        for frame in ("X_PB", "X_BC", "X_BD")
        for key, span in ({"translation": PLACE} | _ROTATION).items()
    },
}

#: Words that a key may be.
WORDS: dict[str, Sequence[str]] = {
    "simulator_config.integration_scheme": GetIntegrationSchemes(),
    "plant_config.contact_model": ("point", "hydroelastic", "hydroelastic_with_fallback"),
    "plant_config.discrete_contact_approximation": ("tamsi", "sap", "similar", "lagged"),
    "plant_config.contact_surface_representation": ("triangle", "polygon"),
}
