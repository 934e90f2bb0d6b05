"""``feasigrasp doctor``: check that everything needed is installed and works.

Every line begins with ``ok``, ``problem`` or ``without``; what is missing in a line of the last
kind is needed for extras only. The exit status is 1 if there is a problem.

Libraries are imported where they are looked at, so that one that is missing hides no other.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

from feasigrasp import __version__
from feasigrasp.errors import FeasigraspError
from feasigrasp.resources import diagram_path

#: Modules of packages that are called otherwise.
_MODULES = {"drake": "pydrake", "lazy-loader": "lazy_loader", "pillow": "PIL", "pyyaml": "yaml"}
#: What needs one of `LARGE_PACKAGES`.
_PARTS = {
    "torch": "training, the samplers paper and diffusion, and the controller diffusion",
    "open3d": "meshes of more than 4000 faces, training data and the evaluation of tracking",
}
#: Files that come with the package: of each network, and of the reachable space.
_WEIGHTS = ("grasp_network", "hidden_side")
#: Prints the depth that a camera sees in the middle of a wall that is 0.9 m away.
_RENDER = """
from pydrake.geometry import *
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo

scene_graph = SceneGraph()
scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
wall = GeometryInstance(RigidTransform([0.0, 0.0, 1.0]), Box(1.0, 1.0, 0.2), "wall")
properties = PerceptionProperties()
properties.AddProperty("label", "id", RenderLabel(1))
wall.set_perception_properties(properties)
scene_graph.RegisterAnchoredGeometry(scene_graph.RegisterSource("doctor"), wall)
query = scene_graph.get_query_output_port().Eval(scene_graph.CreateDefaultContext())
lens = CameraInfo(width=32, height=32, fov_y=0.8)
core = RenderCameraCore("vtk", lens, ClippingRange(0.05, 5.0), RigidTransform())
camera = DepthRenderCamera(core, DepthRange(0.1, 3.0))
image = query.RenderDepthImage(camera, scene_graph.world_frame_id(), RigidTransform())
print("depth", float(image.data[16, 16, 0]))
"""
#: Runs a packaged scenario by the wrist camera for 0.2 s, as a user would.
_RUN = """
from feasigrasp.cli import main

raise SystemExit(main(["run", "ReachLinear", "--duration", "0.2"]))
"""


class Finding(NamedTuple):
    """Result of one check: what was found, with the mend if it is not as it should be."""

    health: str
    text: str


_ok, _problem, _without = (partial(Finding, health) for health in ("ok", "problem", "without"))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command: none."""


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    problems = 0
    for look in LOOKS:
        for finding in _carefully(look):
            problems += finding.health == "problem"
            print(f"{finding.health:8s} {finding.text}", flush=True)
    print("all is well" if problems == 0 else f"problems: {problems}")
    return min(problems, 1)


def _carefully(look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """What a look finds; if a library keeps it from looking, that."""
    try:
        yield from look()
    except Exception as error:
        yield _problem(f"{look.__name__.replace('_', ' ')}: {error}")


def libraries() -> Iterator[Finding]:
    """Whether every package that is required can be imported, in a release that is supported."""
    python = ".".join(map(str, sys.version_info[:3]))
    yield _ok(f"feasigrasp {__version__}, Python {python}")
    for entry in requires("feasigrasp") or []:
        if "extra ==" in entry:
            continue
        needed = Requirement(entry)
        name, mend = needed.name, f"pip install '{entry}'"
        try:
            import_module(_MODULES.get(name, name))
            if needed.specifier.contains(version(name), prereleases=True):
                yield _ok(f"{name} {version(name)}")
            else:
                yield _problem(f"{name} {version(name)} is none of {needed.specifier}: {mend}")
        except (PackageNotFoundError, ModuleNotFoundError):
            text = f"{name} is not installed: {mend}"
            part = _PARTS.get(name)
            yield _problem(text) if part is None else _without(f"{text}, for {part}")
        except Exception as error:  # whatever a library stumbles over when it is loaded
            mend = f"pip install --force-reinstall --no-deps '{entry}', or make setup"
            yield _problem(f"{name} does not load ({error}): {mend}")


def rendering() -> Iterator[Finding]:
    """Whether Drake's VTK engine renders, tested in a separate process that it may crash."""
    mend = "install libegl1 and libgl1 (Debian), or run 'make setup'"
    command = [sys.executable, "-c", _RENDER]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        yield _problem(f"rendering takes more than two minutes: {mend}")
        return
    depth = re.search(r"^depth ([\d.]+)$", done.stdout, re.MULTILINE)
    if depth and abs(float(depth[1]) - 0.9) < 1e-3:
        yield _ok("rendering: VTK sees a wall where it is")
    elif depth:
        text = f"rendering: VTK sees a wall at {float(depth[1]):.3f} m that is 0.9 m away"
        yield _problem(f"{text}; update the graphics driver")
    else:
        why = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
        yield _problem(f"rendering fails ({why}): {mend}")


def threads() -> Iterator[Finding]:
    """Number of processors, and of threads that the libraries use."""
    import joblib
    import numpy as np
    from threadpoolctl import threadpool_info

    np.ones((2, 2)) @ np.ones((2, 2))  # loads BLAS
    pools = {f"{pool['internal_api']} {pool['num_threads']}" for pool in threadpool_info()}
    yield _ok(
        f"processors {joblib.cpu_count()}; threads of {', '.join(sorted(pools)) or 'no pool'}; "
        "a simulation uses one"
    )


def compiled_code() -> Iterator[Finding]:
    """Location, writability and size of the cache of compiled code."""
    mend = "set NUMBA_CACHE_DIR to a folder that can be written to"
    try:
        kernels = import_module("feasigrasp.models.geometry.se3_kernels")
    except RuntimeError as error:  # numba finds no place
        yield _problem(f"compiled code: {error}; {mend}")
        return
    folder = Path(kernels.inverse_kernel.stats.cache_path)
    package = Path(__file__).parents[1]
    place = package if package in folder.parents else folder.parent
    size = sum(file.stat().st_size for file in place.rglob("*.nb[ic]")) / 1e6
    text = f"compiled code: {size:.0f} MB in {place}"
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not os.access(there, os.W_OK):
        text += f", which cannot be written to, so that every run compiles anew: {mend}"
        yield _problem(text)
    else:
        yield _ok(text + ("" if size else ": the first run compiles, for minutes"))


def solids() -> Iterator[Finding]:
    """Whether manifold3d unites two boxes that overlap, as the bodies of a mesh are."""
    import trimesh

    boxes = [
        trimesh.creation.box(transform=trimesh.transformations.translation_matrix([x, 0, 0]))
        for x in (0.0, 0.5)
    ]
    volume = trimesh.boolean.union(boxes, engine="manifold").volume
    if abs(volume - 1.5) < 1e-6:
        yield _ok("meshes: manifold3d unites bodies that overlap")
    else:
        mend = "reinstall manifold3d"
        yield _problem(f"meshes: two boxes of volume 1.5 together have {volume:g}; {mend}")


def files() -> Iterator[Finding]:
    """Whether weights, models and scenarios are there and whole."""
    from feasigrasp.inputs import read_arrays
    from feasigrasp.models.weights_file import WEIGHTS

    mend = "reinstall feasigrasp, or 'git checkout' the file"
    try:
        for name in _WEIGHTS:
            arrays = read_arrays(WEIGHTS / f"{name}.npz")
            yield _ok(f"{name}.npz: {len(arrays)} arrays")
        yield _ok(f"scenarios: {diagram_path('dynamic.scenarios.yaml')}")
    except FeasigraspError as error:
        yield _problem(f"{error}: {mend}")


def scenario() -> Iterator[Finding]:
    """Whether a scenario of the package builds and simulates, tested in a separate process."""
    from feasigrasp.warm_up import is_warm

    if not is_warm({"task"}):
        print("note: trying a scenario compiles for minutes, once", file=sys.stderr)
    done = subprocess.run([sys.executable, "-c", _RUN], capture_output=True, text=True)
    if done.returncode == 0:
        yield _ok("scenario: ReachLinear runs for 0.2 s, camera included")
        return
    lines = done.stderr.strip().splitlines()[-1:] or done.stdout.strip().splitlines()[:1]
    why = lines[0] if lines else f"status {done.returncode}"
    drake = next((entry for entry in requires("feasigrasp") or [] if entry.startswith("drake")), "")
    yield _problem(
        f"scenario: ReachLinear does not run ({why}): pip install --force-reinstall '{drake}', or "
        "see 'feasigrasp run ReachLinear --duration 0.2' for all of it"
    )


def browser() -> Iterator[Finding]:
    """Whether there is a browser that takes pictures of replays."""
    from feasigrasp.runs import replay

    if found := replay.browser():
        yield _ok(f"browser for pictures of replays: {found}")
    else:
        yield _without("chromium: no pictures of replays; install chromium")


def messages() -> Iterator[Finding]:
    """Whether messages of the size of an image come back over multicast on the loopback."""
    from pydrake.lcm import DrakeLcm

    from feasigrasp.systems.hardware.channels import LCM_URL

    mend = (
        "ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo. Only 'feasigrasp sim' and "
        "'run --hardware' need it"
    )
    try:
        sender, receiver = DrakeLcm(LCM_URL), DrakeLcm(LCM_URL)
    except RuntimeError as error:
        yield _without(f"messages: no bus at {LCM_URL} ({error}): {mend}")
        return
    came: list[int] = []
    receiver.Subscribe("FEASIGRASP_DOCTOR", lambda data: came.append(len(data)))
    size = 200_000
    for _ in range(10):
        sender.Publish("FEASIGRASP_DOCTOR", bytes(size))
        receiver.HandleSubscriptions(100)
    if came == [size] * 10:
        yield _ok(f"messages: multicast on the loopback works ({LCM_URL})")
    else:
        some = f"{len(came)} of 10 images come over the loopback: raise net.core.rmem_max"
        none = f"none comes back over the loopback: {mend}"
        yield _without(f"messages: {some if came else none}")


#: What is looked at, in this order.
LOOKS = (libraries, rendering, threads, solids, compiled_code, files, scenario, browser, messages)
