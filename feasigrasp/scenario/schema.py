"""The scenario: one dataclass that *is* the YAML format of ``diagrams/*.scenarios.yaml``.

A scenario file maps names to scenarios; a file is read with `load_scenario`, which refuses unknown
keys by name, and what ran is written back with `dump_scenario`.
"""

import dataclasses as dc
import typing

import numpy as np
from pydrake.common.schema import Rotation, Uniform
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.control.mode import ControlMode, ControlSpace
from feasigrasp.models.grasps.sequence import GraspSequenceConfig
from feasigrasp.models.objects.tracker_config import TrackerConfig
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.faults import AnyFault


@dc.dataclass
class ObjectConfig:
    """The object to grasp.

    Attributes:
        model: Name of a built-in object, or a path to a mesh.
        scale: Factor from the mesh's unit to metres.
        mass: Mass [kg]; from the object's data or its volume if not given.
        friction: Coulomb friction of its surface, and of the fingers on it.
        rotation: Orientation at the start; ``!Uniform {}`` draws it from the seed.
    """

    model: str = "mustard_bottle"
    scale: float = 1.0
    mass: float | None = None
    friction: float = 0.8
    rotation: typing.Union[  # noqa: UP007 - the form of Drake's own schema
        Rotation.Identity, Rotation.Rpy, Rotation.AngleAxis, Rotation.Uniform
    ] = dc.field(default_factory=Rotation.Identity)


@dc.dataclass
class MotionConfig:
    """How the object moves until it is let go; see `HarmonicMotion` for the formula.

    Attributes:
        center: [m].
        amplitude: [m], along x, y, z.
        harmonic: Multiple of the phase along x, y, z.
        offset_deg: Phase offset along x, y, z [deg]; 90 makes a cosine.
        rate: Phase rate [rad/s].
        start_phase: Phase at the start [rad]; ``!Uniform`` draws it from the seed.
        spin_axis: Axis of the constant rotation, in the world.
        spin: Its speed [rad/s].
    """

    center: list[float] = dc.field(default_factory=lambda: [0.5, 0.0, 0.55])
    amplitude: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    harmonic: list[float] = dc.field(default_factory=lambda: [1.0, 1.0, 1.0])
    offset_deg: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 0.0])
    rate: float = 0.2 * np.pi
    start_phase: typing.Union[float, Uniform] = 0.0  # noqa: UP007 - Drake's YAML needs Union
    spin_axis: list[float] = dc.field(default_factory=lambda: [0.0, 0.0, 1.0])
    spin: float = 0.2


@dc.dataclass
class PerceptionConfig:
    """How often the object is looked at, and the distance field that is fitted.

    Attributes:
        camera: Name of the camera that is used.
        period: Time between views [s].
        latency: Time from a view to its grasps [s].
        preset: ``default``, or ``paper`` for the paper's field; see `complete_shape`.
        max_points: Points that the field is fitted to.
        length_scale: Length scale of the field's kernel [m].
        voxel_size: Resolution at which views are merged in the object frame [m].
        sampler: ``network`` (learned), ``paper`` or ``antipodal`` (model-free); see `SamplerName`.
        n_candidates: Grasp candidates drawn per update.
        n_grasps: Grasps kept per update.
    """

    camera: str = "wrist_camera"
    period: float = 0.5
    latency: float = 0.1
    preset: str = "default"
    max_points: int = 320
    length_scale: float = 0.3
    voxel_size: float = 0.003
    sampler: str = "network"
    n_candidates: int = 800
    n_grasps: int = 64


@dc.dataclass
class SceneConfig:
    """The surroundings, as the camera sees them, that the open hand keeps clear of.

    Attributes:
        enabled: Whether they are looked at.
        period: Time between views [s].
        resolution: Edge length of the voxels of the scene [m].
        margin: Least distance between the open hand and the scene [m].
    """

    enabled: bool = False
    period: float = 1.0
    resolution: float = 0.01
    margin: float = 0.005


@dc.dataclass
class ReachabilityConfig:
    """The reachability filter between perception and control.

    Attributes:
        period: Time between updates [s].
        method: ``ik`` (exact inverse kinematics), ``rmm`` (the paper's density of reachable poses),
            or ``both`` (exact on what the density lets through).
        horizon: A grasp must stay reachable this long, as the object moves now [s].
    """

    period: float = 0.1
    method: str = "ik"
    horizon: float = 1.0


@dc.dataclass
class ControlConfig:
    """The arm's controller.

    Attributes:
        controller: ``task`` (Riemannian mixture) or ``joint`` (distance field over IK solutions).
        mode: ``safe`` enforces limits and clearances, ``paper`` enforces nothing.
        period: Control period [s].
        source: Where the joint-space controller's configurations come from: ``closed_form``,
            ``flow`` (the IK flow) or ``dls`` (damped least squares).
    """

    controller: str = ControlSpace.TASK.value
    mode: str = ControlMode.SAFE.value
    period: float = 0.005
    source: str = "closed_form"

    @property
    def safe(self) -> bool:
        """Whether limits and clearances are enforced.

        Raises:
            ScenarioError: There is no such mode.
        """
        return (
            parse_choice(ControlMode, self.mode, "control.mode", ScenarioError) is ControlMode.SAFE
        )


def _default_plant() -> MultibodyPlantConfig:
    return MultibodyPlantConfig(
        time_step=0.002,
        # Sampled outputs would make every step an update of the whole diagram's state.
        use_sampled_output_ports=False,
        contact_model="hydroelastic_with_fallback",
        discrete_contact_approximation="lagged",
    )


def _default_simulator() -> SimulatorConfig:
    return SimulatorConfig(max_step_size=0.01, publish_every_time_step=False)


@dc.dataclass
class Scenario:
    """Everything that a run depends on.

    Attributes:
        random_seed: Seed of all that the scenario leaves to chance.
        simulation_duration: Length of the run [s]; a run ends earlier when the grasp is over.
        simulator_config: Drake's simulator settings.
        plant_config: Drake's plant settings.
        directives: The robot cell; see ``models/iiwa/cell.dmd.yaml``.
        cameras: Cameras by name.
        camera_noise: By camera, errors of its depth image; ``{wrist_camera: {}}`` gives it those of
            a RealSense D435, entries as in `DepthNoise` change them. A camera not named has none.
        q_start: Joint positions at the start [deg].
        object: The object.
        motion: How it moves.
        tracker: How its pose is measured.
        perception: Views, distance field, grasps.
        scene: Surroundings that grasps keep clear of.
        reachability: Reachability filter.
        control: Controller.
        grasp: Closing, letting go, lifting.
        faults: What goes wrong, and when, e.g. ``!PoseNan {start: 2, duration: 0.5}``.
    """

    random_seed: int = 0
    simulation_duration: float = 30.0
    simulator_config: SimulatorConfig = dc.field(default_factory=_default_simulator)
    plant_config: MultibodyPlantConfig = dc.field(default_factory=_default_plant)
    directives: list[ModelDirective] = dc.field(default_factory=list)
    cameras: dict[str, CameraConfig] = dc.field(default_factory=dict)
    camera_noise: dict[str, dict[str, float]] = dc.field(default_factory=dict)
    q_start: list[float] = dc.field(default_factory=lambda: [0.0] * IIWA_7.joints)
    object: ObjectConfig = dc.field(default_factory=ObjectConfig)
    motion: MotionConfig = dc.field(default_factory=MotionConfig)
    tracker: TrackerConfig = dc.field(default_factory=TrackerConfig)
    perception: PerceptionConfig = dc.field(default_factory=PerceptionConfig)
    scene: SceneConfig = dc.field(default_factory=SceneConfig)
    reachability: ReachabilityConfig = dc.field(default_factory=ReachabilityConfig)
    control: ControlConfig = dc.field(default_factory=ControlConfig)
    grasp: GraspSequenceConfig = dc.field(default_factory=GraspSequenceConfig)
    faults: list[AnyFault] = dc.field(default_factory=list)
