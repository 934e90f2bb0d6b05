"""Records the wrist camera during a simulated run, with perfect depth images.

The arm keeps the object in view as it does by itself, and no tracker that is judged moves it. The
errors of a sensor are put on the images when they are played, so that one recording serves every
sensor. The true poses are there for judging alone.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from feasigrasp.errors import InputError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import Camera, stereo_deviation, unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.geometry import se3
from feasigrasp.models.sensors.camera_errors import MATERIALS, CameraErrors
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.station.camera import pixel_centred_intrinsics
from feasigrasp_lab.results.finished import write_arrays
from feasigrasp_lab.results.workers import made_with


@dataclass(frozen=True)
class Sensor:
    """A depth camera.

    Attributes:
        noise: Its errors.
        near: Least depth that it measures [m].
    """

    noise: DepthNoise
    near: float


#: Those that the tracker is judged with; focal length and size are those of the recording. The
#: second has the errors of the Reach scenarios' camera, but for its calibration.
SENSORS = {
    "d435": Sensor(DepthNoise(decimation=2), 0.105),
    "d405": Sensor(DepthNoise(baseline=0.018, motion_blur=1.0, dropped=0.02, decimation=2), 0.07),
}


def images(recording: Recording, sensor: Sensor, seed: int) -> Iterator[tuple[int, ObjectView]]:
    """The images of a recording, as a sensor would have made them.

    Args:
        recording: The recording.
        sensor: The sensor.
        seed: Of its errors.
    """
    h, w = recording.depths.shape[1:]
    fx, fy, cx, cy = recording.intrinsics.tolist()
    deviation = stereo_deviation(fx * sensor.noise.decimation, sensor.noise.baseline)
    camera = Camera((fx, fy, cx, cy), w, h, sensor.near, deviation)
    errors = CameraErrors(sensor.noise, seed, (h, w))
    for k, X_WC in enumerate(recording.X_WC):
        depth = recording.depth(k)
        depth[depth < sensor.near] = 0.0
        rng = np.random.default_rng([seed, k])
        poses = X_WC, se3.inverse(recording.X_WO[k]) @ X_WC
        fixed = errors.fixed(depth, camera.intrinsics, poses, recording.masks[k], MATERIALS["matt"])
        limits = {"near": sensor.near, "far": 3.0}
        depth = sensor.noise.apply(depth, recording.intrinsics, rng, **limits, fixed=fixed)
        seen = np.isfinite(depth) & (depth > 0.0)
        points = unproject(np.where(seen, depth, np.inf), camera.intrinsics)
        mask = recording.masks[k]
        used = mask & seen & ~edge_pixels(points, seen, mask, EDGE_JUMP)
        points_W = points[:, used].T @ X_WC[:3, :3].T + X_WC[:3, 3]
        yield k, ObjectView(camera, X_WC, points_W, depth)


#: Images per second. Source: definition.
RATE = 30.0
#: Unit of the stored depths [m]. Source: definition.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Recording:
    """A sequence of images of one object.

    Attributes:
        times: Of the images, shape (n,) [s].
        depths: Perfect depth along the optical axis in steps of 0.1 mm, 0 where it is too near and
            65535 where nothing is measured, shape (n, h, w).
        masks: Which pixels show the object, shape (n, h, w).
        X_WC: Poses of the camera, z forward, shape (n, 4, 4).
        X_WO: True poses of the object, shape (n, 4, 4).
        V_WO: Its true twists, shape (n, 6).
        intrinsics: fx, fy, cx, cy for whole-numbered pixels [px], shape (4,).
        hold: Whether the object still moves by itself, shape (n,).
    """

    times: Array
    depths: NDArray[np.uint16]
    masks: Mask
    X_WC: Array
    X_WO: Array
    V_WO: Array
    intrinsics: Array
    hold: Mask

    def depth(self, k: int) -> Array:
        """Depth image ``k``, 0 where it is too near and infinite where nothing is, (h, w) [m]."""
        image = self.depths[k] * _STEP
        return np.asarray(np.where(self.depths[k] == 65535, np.inf, image), dtype=float)


def record(scenario: str, changes: Sequence[str], duration: float) -> Recording:
    """Runs a scenario with perfect depth, and keeps what the wrist camera sees.

    Args:
        scenario: Name of a dynamic scenario.
        changes: What is changed of it, YAML texts.
        duration: Longest time [s]; it ends earlier when the object was let go.
    """
    # What the camera's owner would have to add: depths from here on are recorded [m]. Trackers are
    # judged on images and the truth of one instant, so that none comes late.
    near = 0.03
    text = f"z_near: {near}, clipping_near: 0.02, output_delay: 0.0"
    camera = f"{{cameras: {{wrist_camera: {{{text}}}}}}}"
    ideal = camera, "{camera_noise: {}, sensors: {error_factor: 0}}"
    loaded = load_scenario(diagram_path("dynamic.scenarios.yaml"), scenario, *changes, *ideal)
    diagram = make_dynamic_grasp(loaded)
    station, sequencer = (diagram.GetSubsystemByName(n) for n in ("station", "sequencer"))
    info = pixel_centred_intrinsics(loaded.cameras["wrist_camera"])
    simulator = Simulator(diagram)
    ApplySimulatorConfig(loaded.simulator_config, simulator)
    simulator.Initialize()
    context = simulator.get_context()
    at, hand = station.GetMyContextFromRoot(context), sequencer.GetMyContextFromRoot(context)

    def output(name: str):  # type: ignore[no-untyped-def]
        return station.GetOutputPort(name).Eval(at)

    label, rows, let_go = int(station.object_body.index()), [], np.inf
    # A recording ends so long after the object was let go [s].
    while context.get_time() <= min(duration, let_go + 0.3) - 1e-6:
        depth = output("wrist_camera.depth_image").data[:, :, 0].astype(float)
        whole = np.round(np.where(np.isfinite(depth), depth, 0.0) / _STEP)
        hold = bool(sequencer.GetOutputPort("object_hold").Eval(hand)[0] > 0.5)
        rows.append(
            (
                context.get_time(),
                np.where(np.isfinite(depth), np.minimum(whole, 65534), 65535).astype(np.uint16),
                output("wrist_camera.label_image").data[:, :, 0] == label,
                output("wrist_camera.pose").GetAsMatrix4(),
                output("object.pose").GetAsMatrix4(),
                output("object.velocity").get_coeffs(),
                hold,
            )
        )
        let_go = let_go if hold else min(let_go, context.get_time())
        simulator.AdvanceTo(len(rows) / RATE)
    times, depths, masks, X_WC, X_WO, V_WO, holds = map(np.array, zip(*rows, strict=True))
    intrinsics = info.focal_x(), info.focal_y(), info.center_x(), info.center_y()
    return Recording(times, depths, masks, X_WC, X_WO, V_WO, np.array(intrinsics), holds)


def recorded(
    filename: Path, scenario: str, changes: Sequence[str], duration: float, mesh: Path | None = None
) -> Recording:
    """The recording in a file, if the same code made it of the same; else it is made now.

    Args:
        filename: The file.
        scenario: See `record`, as are the next two.
        changes: See there.
        duration: See there.
        mesh: The object's own file, if it has one: another content is another object.
    """
    made_of = {"scenario": scenario, "changes": list(changes), "duration": duration}
    content = mesh.read_bytes() if mesh is not None and mesh.is_file() else b""
    key = json.dumps(made_with() | made_of | {"mesh": sha256(content).hexdigest()})
    try:
        found = read_arrays(filename)
    except InputError:  # there is none, or no whole one
        found = {}
    if str(found.get("key")) != key:
        made = record(scenario, changes, duration)
        write_arrays(filename, {**vars(made), "key": np.array(key)})
        return made
    return Recording(**{name: found[name] for name in Recording.__dataclass_fields__})
