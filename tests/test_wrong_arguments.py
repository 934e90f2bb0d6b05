"""Wrong arguments of public functions are refused by name, before any kernel reads them."""

import inspect
import re
from collections import Counter
from dataclasses import fields, is_dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from feasigrasp.errors import FeasigraspError
from tests.public_arguments import Examples, public_callables

#: What docstrings allow although it is a mutation: ``Function.parameter:mutation``, and why. The
#: result has the form of the right one then, and is finite unless the mutation is not.
LEGAL = {
    "*:fewer": "any number of rows, where no other argument has as many (`MATCHED`)",
    "se3.*:deeper": "any leading axes",
    "se3.*:NaN": "NaN in, NaN out",
    "se3.*:infinite": "the same",
    "se3.*:mirrored": "rotations are taken as they are",
    "*_kinematics.q:deeper": "any leading axes",
    "*_kinematics.q:NaN": "NaN in, NaN out",
    "pose_and_jacobian.q:deeper": "any leading axes",
    "pose_and_jacobian.q:NaN": "NaN in, NaN out",
    "manipulability.q:deeper": "any leading axes",
    "manipulability.q:NaN": "NaN in, NaN out",
    "*.q:infinite": "not finite, as NaN",
    "Arm.positions.q:NaN": "handed on to those",
    "closed_form.*:NaN": "an unknown pose or angle has no solution",
    "closed_form.*:infinite": "the same",
    "closed_form.psi:a number": "one angle for all poses",
    "Reachability.*:deeper": "any leading axes, in one row of verdicts",
    "Reachability.*.q:NaN": "no admissible configuration, and none nearest",
    "Re*.*.X_W?:NaN": "an unknown pose is not reached",
    "Re*.*.X_W?:infinite": "the same",
    "Situation.q:degrees": "measured: without limits, joints may be wound up by many turns",
    "Situation.[XV]_WO:NaN": "the object is lost: nothing is in reach",
    "Situation.[XV]_WO:infinite": "the same",
    "Situation.[qv]:NaN": "the state of the arm is not known",
    "Situation.v:infinite": "the same",
    "Situation.future.ahead:*": "any number of times",
    "feasible_grasps.kept_before:*": "any number of ids",
    "SafetyFilter.*:NaN": "a request or state that is not finite: the arm brakes",
    "SafetyFilter.*:infinite": "the same",
    "*.enforced.*:NaN": "the same",
    "*.enforced.*:infinite": "the same",
    "*.in_view.qd:NaN": "the same; handed on without a camera",
    "*.in_view.qd:infinite": "the same",
    "CameraErrors.fixed.depth:NaN": "a pixel without depth",
    "CameraErrors.fixed.depth:infinite": "the same",
    "DepthNoise.apply.depth:*": "an image of any size; 0, NaN and infinity stand for no depth",
    "*.far:infinite": "no bound",
    "*.max_*:infinite": "no bound",
    "*.silence:infinite": "no bound",
    "*.revisit:infinite": "never",
    "Camera.*.points_C:NaN": "a pixel without depth",
    "Camera.*.points_C:infinite": "the same",
    "ObjectView.points_W:*": "the same",
    "ObjectView.depth:*": "no depth",
    "ObjectView.X_WC:NaN": "an unknown pose: the image is ignored",
    "ObjectView.X_WC:infinite": "the same",
    "FieldTrack.X_WC:NaN": "the same",
    "FieldTrack.X_WC:infinite": "the same",
    "FieldTrack.*_at:infinite": "never",
    "FieldTrack.image_time:infinite": "never",
    "FieldTrack.unknown_since:infinite": "never",
    "FieldTrack.deviation:infinite": "unknown",
    "FieldTrack.*motion:*": "a filter that has seen nothing holds NaN",
    "*.cholesky:NaN": "only the lower triangle means anything",
    "*.cholesky:infinite": "the same",
    "FusedCloud.weights:empty": "none, or one for each point",
    "GraspSet.id:empty": "none, or one for each grasp",
    "GraspSet.on_object:*": "any number of ids",
    "GraspSet.select.keep:empty": "no grasps",
    "GraspSet.select.keep:shorter": "any indices",
    "GraspSet.select.keep:longer": "any indices",
    "Result.samples:*": "a figure that is not known",
    "DepthFolder.X_WC:NaN": "an image without a pose",
    "DepthFolder.X_WC:infinite": "the same",
    "G*Controller.chosen.memory:*": "no one grasp, whatever is remembered",
    "*.viewpoint:nothing": "a cloud of views from several sides",
    "fit_gpdf.surface_offset:nothing": "the paper's field",
    "track.gpdf:nothing": "no field yet",
    "track.looked:infinite": "never",
    "GraspController.memory:*": "whatever a controller of one's own remembers",
}
#: Arguments that another one has as many rows as.
MATCHED = {
    "FusedCloud.points", "FusedCloud.directions", "GraspSet.X_OG", "filter_grasps.X_OG",
    "filter_grasps.prior", "SceneField.points",
    "Gpdf.ray_exits.starts", "Gpdf.ray_exits.directions", "CompletedField.cloud", "Gpdf.nodes",
    "Gpdf.cholesky", "se3.make_pose.R", "se3.make_pose.p", "SafetyFilter.velocity.J", "Gpdf.bounds",
}  # fmt: skip


def mutations(parameter, value):
    """Wrong values in place of a right one, by the name of what is wrong with them."""
    yield "nothing", None
    yield "an object", object()
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        yield from array_mutations(parameter, value)
    elif isinstance(value, bool):
        yield from (("a word", "no"), ("a number", 0.5))
    elif isinstance(value, int | float):
        yield from (("a word", "much"), ("complex", 1j), ("two numbers", np.array([value, value])))
        yield from (("NaN", np.nan), ("infinite", np.inf), ("infinite", -np.inf))
        if isinstance(value, int):
            yield from (("a fraction", value + 0.5), ("negative", -1 - value))
    elif isinstance(value, str | Path):
        yield from (("a number", 3), ("words", ["a", "b"]))
    elif isinstance(value, tuple | list) and value and isinstance(value[0], float):
        yield from (("a word", "much"), ("shorter", value[:-1]), ("words", ("a",) * len(value)))
        yield from (("empty", ()), ("NaN", (np.nan, *value[1:])))
    else:
        yield from (("a word", "this"), ("a number", 0.5))


def array_mutations(parameter, value):
    yield from (("a word", "this"), ("a number", 0.5), ("empty", np.zeros(0)))
    yield "deeper", value[None]
    yield "shorter", value[..., :-1]
    yield "longer", np.concatenate([value, value[..., -1:]], axis=-1)
    yield "words", value.astype(str)
    yield "complex", value + 1j
    yield "objects", np.full(value.shape, None)
    if value.ndim > 1:
        yield "flat", value.ravel()
        yield "fewer", value[:-1]
        if value.T.shape != value.shape:
            yield "transposed", value.T
    if parameter in ("q", "q_start"):
        yield "degrees", np.rad2deg(value)
    if value.shape[-2:] == (4, 4) or parameter in ("R", "R_WO"):
        yield "mirrored", value * np.where(np.arange(value.shape[-1]) == 0, -1.0, 1.0)
    if value.dtype.kind == "f" and value.size:
        for name, wrong in (("NaN", np.nan), ("infinite", np.inf)):
            broken = value.copy()
            broken.flat[:1] = wrong
            yield name, broken


def outcome(function, arguments, parameter, value):
    """Whether a wrong value is refused, and else what is wrong with that or what is returned."""
    try:
        return False, function(**(arguments | {parameter: value}))
    except (FeasigraspError, TypeError, ValueError) as error:
        named = re.search(rf"\b{parameter}\b", str(error)) is not None
        return named, f"{type(error).__name__} without the name: {error}"
    except Exception as error:
        return False, f"{type(error).__name__}: {error}"


def numbers(result):
    """All arrays and numbers of a result, in order."""
    if is_dataclass(result) and not isinstance(result, type):
        # Of a Cholesky factor half is not written.
        entries = [f.name for f in fields(result) if f.name != "cholesky"]
        return [n for name in entries for n in numbers(getattr(result, name))]
    if isinstance(result, tuple | list):
        return [n for item in result for n in numbers(item)]
    is_number = isinstance(result, np.ndarray | np.generic | float)
    return [np.asarray(result)] if is_number and np.asarray(result).dtype.kind in "fiub" else []


def is_well_formed(mutation, result, right):
    """Whether a result has the form of the right one, and no number that nobody wrote."""
    given, wanted = numbers(result), numbers(right)
    alike = type(result) is type(right) and len(given) == len(wanted)
    if not alike and mutation != "nothing":  # without an optional argument there may be no result
        return False
    if mutation in ("NaN", "infinite"):
        return True
    # What was read beyond an array is a denormal number, most often, or huge.
    size = [np.abs(each[np.isfinite(each)]) for each in given]
    return all(((each == 0) | ((each > 1e-300) & (each < 1e9))).all() for each in size)


def test_wrong_arguments_are_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    examples, counts, wrong, used = Examples(tmp_path), Counter(), [], set()
    for name, public in public_callables().items():
        function, arguments = examples.call(name, public)
        counts["functions"] += 1
        for parameter, value in arguments.items():
            default = inspect.signature(function).parameters[parameter].default
            for mutation, mutated in mutations(parameter, value):
                if mutated is None and (default is None or value is None):
                    continue
                refused, result = outcome(function, arguments, parameter, mutated)
                counts["refused"] += refused
                place = f"{name}.{parameter}:{mutation}"
                legal = {pattern for pattern in LEGAL if fnmatch(place, pattern)}
                if place.removesuffix(":fewer") in MATCHED:
                    legal = set()
                if refused:
                    continue
                used |= legal
                if not legal or isinstance(result, str) and " without the name: " in result:
                    wrong.append(f"{place}: {str(result)[:160]!r}")
                elif not is_well_formed(mutation, result, function(**arguments)):
                    wrong.append(f"{place}: allowed, but gives {str(result)[:160]!r}")
    assert not wrong, "\n".join(wrong)
    assert set(LEGAL) == used
    assert counts["functions"] > 180 and counts["refused"] > 4500, counts
