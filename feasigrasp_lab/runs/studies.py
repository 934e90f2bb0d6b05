"""Studies of the dynamic evaluation: runs and changes of each."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from feasigrasp_lab.protocols.ablations import ABLATIONS
from feasigrasp_lab.protocols.changes import (
    AT_SPEEDS,
    AT_SPINS,
    BODIES,
    CAMERA_MOTIONS,
    DEGRADATIONS,
    MOTIONS,
    Change,
    given_truth,
    motion_capture,
    perfect_sensors,
    unchanged,
)

#: Object of the size of the paper's, 5.8 x 5.4 x 4.1 cm.
PAPER_OBJECT = "duck"
#: Each degradation by the end of its runs' names.
_DEGRADED = {f"-with-{name}": change for name, change in DEGRADATIONS.items()}


@dataclass(frozen=True)
class Study:
    """One part of the evaluation, and the defaults of its scenarios.

    Attributes:
        scenarios: Their names.
        objects: What ``--objects`` is by default.
        seeds: Repeats.
        modes: Modes of the controllers.
        variants: What it changes in every scenario, by what the names of the runs have behind the
            scenario's, so that they are not taken for those of another study.
        generated: Whether it can run on generated objects, with ``--split test``.
    """

    scenarios: tuple[str, ...]
    objects: str = "builtin"
    seeds: int = 1
    modes: tuple[str, ...] = ("safe",)
    variants: Mapping[str, Change] = field(default_factory=lambda: {"": unchanged})
    generated: bool = True


_REACH = ("ReachCircular", "ReachLinear", "ReachSinusoidal")
_MOCAP = tuple(f"{name}Mocap" for name in _REACH)
_PAPER = ("PaperCircular", "PaperLinear", "PaperSinusoidal")
_CLUTTER = ("ReachLinearCarried", "ReachLinearBelt", "ReachLinearBeside", "ReachLinearAlong")

_BESIDE_WALL = f"{PAPER_OBJECT},soup_can,small_box"

#: ``reach`` grasps and lifts moving objects of all kinds with the wrist camera alone, ``clutter``
#: where it also sees what carries the object, or another one beside it; in ``truth`` pose and
#: pixels are given, with the same camera and its noise; in ``mocap`` likewise, with a better
#: camera, as in all others: ``ideal`` with perfect sensors, ``tracking`` with the errors of motion
#: capture, ``obstacle`` beside a wall (``obstacle-camera`` by the camera alone), ``cell`` beside
#: modeled bodies; ``paper`` is the
#: paper's dynamic test, slowly and four times as fast; ``speed`` and ``spin`` are the curves of
#: success over how fast the object moves and turns, ``speed-camera`` the first with the camera
#: alone; ``degradations`` is what errors of sensors and other objects cost by the camera alone,
#: each of them and all together; ``ablation`` what each part of the system is worth.
STUDIES = {
    "reach": Study(_REACH, seeds=2),
    "truth": Study(_REACH, seeds=2, variants={"-truth": given_truth}),
    "clutter": Study(_CLUTTER),
    "mocap": Study(_MOCAP, seeds=3),
    "ideal": Study(_MOCAP, variants={"-ideal": perfect_sensors}),
    "tracking": Study(_MOCAP, variants={"-tracking": motion_capture}),
    "obstacle": Study(("ReachObstacleMocap",), _BESIDE_WALL, 3),
    "obstacle-camera": Study(("ReachObstacle",), _BESIDE_WALL, 3),
    "cell": Study(_MOCAP[:2], "soup_can,small_box", variants=BODIES),
    "paper": Study(
        _PAPER + tuple(f"{name}Fast" for name in _PAPER),
        PAPER_OBJECT,
        5,
        ("paper", "corrected", "safe"),
        generated=False,
    ),
    "speed": Study(tuple(MOTIONS.values()), variants=AT_SPEEDS),
    "speed-camera": Study(tuple(CAMERA_MOTIONS.values()), variants=AT_SPEEDS),
    "spin": Study((MOTIONS["circle"],), variants=AT_SPINS),
    "degradations": Study((CAMERA_MOTIONS["circle-camera"],), variants=_DEGRADED),
    "ablation": Study(_REACH[:1], seeds=2, variants=ABLATIONS),
}


def study_of(scenario_name: str) -> Study:
    """The study that a scenario belongs to; of a scenario of one's own, ``reach``."""
    return next(
        (study for study in STUDIES.values() if scenario_name in study.scenarios), STUDIES["reach"]
    )


def suffix_of(run_name: str) -> str:
    """What the study of a run put behind the scenario's name."""
    suffixes = (suffix for study in STUDIES.values() for suffix in study.variants if suffix)
    return next((suffix for suffix in suffixes if run_name.endswith(suffix)), "")
