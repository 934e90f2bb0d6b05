"""The scenario: one dataclass that *is* the YAML format of ``diagrams/*.scenarios.yaml``.

A scenario file maps names to scenarios; a file is read with `load_scenario`, which refuses unknown
keys by name, and what ran is written back with `dump_scenario`. Other control modes than ``safe``
may have other defaults (`feasigrasp.scenario.modes`).
"""

import dataclasses as dc
import typing
from enum import StrEnum

import numpy as np
from pydrake.common.schema import Rotation, Uniform
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.sensors import CameraConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import (
    SAFE,
    SEED,
    TURN,
    ControlSpace,
    Span,
    controller_names,
    key,
    mode_names,
    word,
)
from feasigrasp.models.grasps.samplers import SamplerName, sampler_names
from feasigrasp.models.grasps.sequence import GraspSequenceConfig
from feasigrasp.models.objects.prediction import PredictionModel
from feasigrasp.models.objects.tracking import TrackerConfig
from feasigrasp.models.robot.arm_file import load_arm
from feasigrasp.models.robot.gripper_file import PACKAGED
from feasigrasp.models.sensors.camera_errors import MATERIALS
from feasigrasp.models.sensors.joint_errors import JointErrors
from feasigrasp.models.shape.completion import DEFAULT, field_names
from feasigrasp.plugins import plugins
from feasigrasp.scenario.cell import CarrierConfig, CellConfig, DistractorConfig
from feasigrasp.scenario.faults import AnyFault
from feasigrasp.scenario.parts import Options, Part, PartConfig

#: ``reachability.method``: exact inverse kinematics.
EXACT = "ik"
#: No joint of an arm turns farther.
_JOINTS = Span(-360.0, 360.0, "deg")


@dc.dataclass
class ObjectConfig:
    """The object to grasp.

    Attributes:
        model: Name of a built-in object, or a path to a mesh.
        scale: Factor from the mesh's unit to metres.
        mass: Mass [kg]; from the object's data or its volume if not given.
        mass_factor: The object is this many times as heavy.
        friction: Coulomb friction between it and the gripper; ``!Uniform`` draws it from the seed.
            Estimates have a constant of their own.
        material: What a stereo camera loses of it, one of `MATERIALS`; empty for that of the
            object's data.
        rotation: Orientation at the start; ``!Uniform {}`` draws it from the seed.
    """

    model: str = "mustard_bottle"
    scale: float = key(1.0, 1e-06, 1000000.0)
    mass: float | None = key(None, 0.001, 20.0, "kg")
    mass_factor: float = key(1.0, 0.01, 100.0)
    friction: typing.Union[float, Uniform] = key(0.6, 0.01, 100.0)  # noqa: UP007 - see below
    material: str = word("", ("", *MATERIALS))
    rotation: typing.Union[  # noqa: UP007 - the form of Drake's own schema
        Rotation.Identity, Rotation.Rpy, Rotation.AngleAxis, Rotation.Uniform
    ] = dc.field(default_factory=Rotation.Identity)


@dc.dataclass
class MotionConfig:
    """Motion of the object until its release; see `HarmonicMotion` for the formula.

    Attributes:
        center: [m].
        spread: The centre is drawn from the seed, up to this far off along x, y, z [m].
        amplitude: [m], along x, y, z.
        harmonic: Multiple of the phase along x, y, z.
        offset_deg: Phase offset along x, y, z [deg]; 90 makes a cosine.
        rate: Phase rate [rad/s].
        start_phase: Phase at the start [rad]; ``!Uniform`` draws it from the seed.
        spin_axis: Axis of the constant rotation, in the world.
        spin: Its speed [rad/s].
    """

    center: list[float] = key([0.5, 0.0, 0.55], -2.0, 2.0, "m")
    spread: list[float] = key([0.0, 0.0, 0.0], 0.0, 2.0, "m")
    amplitude: list[float] = key([0.0, 0.0, 0.0], -2.0, 2.0, "m")
    harmonic: list[float] = key([1.0, 1.0, 1.0], -100.0, 100.0)
    offset_deg: list[float] = key([0.0, 0.0, 0.0], *TURN)
    rate: float = key(0.2 * np.pi, -20.0, 20.0, "rad/s")
    start_phase: typing.Union[float, Uniform] = key(  # noqa: UP007 - Drake's YAML needs Union
        0.0, -1000.0, 1000.0, "rad"
    )
    spin_axis: list[float] = key([0.0, 0.0, 1.0], -1000.0, 1000.0)
    spin: float = key(0.2, -20.0, 20.0, "rad/s")


@dc.dataclass
class BezierPath:
    """A path of Bezier curves with stops and turns, drawn from the seed; see `BezierMotion`.

    Attributes:
        center: Middle of the box that the path stays in [m].
        size: Its edges [m].
        speed: Along the curves [m/s].
        stop: Rest between two curves [s].
        spin_axis: Axis of the constant rotation, in the world.
        spin: Its speed [rad/s].
    """

    center: list[float] = key([0.5, 0.0, 0.55], -2.0, 2.0, "m")
    size: list[float] = key([0.2, 0.36, 0.16], 0.01, 2.0, "m")
    speed: float = key(0.15, 0.001, 5.0, "m/s")
    stop: float = key(0.5, 0.0, 60.0, "s")
    spin_axis: list[float] = key([0.0, 0.0, 1.0], -1000.0, 1000.0)
    spin: float = key(0.2, -20.0, 20.0, "rad/s")


class Segmentation(StrEnum):
    """Source of the object's pixels."""

    LABELS = "labels"
    DEPTH = "depth"


class Execution(StrEnum):
    """Process of perception."""

    AUTO = "auto"
    INLINE = "inline"
    PROCESSES = "processes"


@dc.dataclass
class PerceptionConfig:
    """Period of views, and the distance field fitted to them.

    Attributes:
        camera: Name of the camera that is used.
        second_camera: Name of another one, such as one that does not move, in whose images the
            object is tracked while ``camera`` does not show it; empty for none. For ``tracker:
            {kind: camera}`` with ``segmentation: depth``.
        segmentation: Source of the object's pixels: ``labels``, the label image of the
            simulation, or ``depth``, its depth image alone, see `ForegroundSegmentation`.
        execution: Where it works, and planning: ``inline``, between two ticks of the controller, or
            ``processes``, in a process of its own, for which no tick waits; so does what is made of
            the surroundings; ``auto``, the latter where an arm is commanded by its driver's
            messages, else the former.
        period: Time between views [s].
        latency: Time from the exposure of a view to its grasps [s], where the cell is simulated.
        preset: ``default``, or ``paper`` for the paper's field, a plugin of ``fields``.
        max_points: Points that the field is fitted to.
        length_scale: Length scale of the field's kernel [m].
        voxel_size: Resolution at which views are merged in the object frame [m].
        hidden_side: Whether what lies behind the seen surface is guessed; not by the paper's field.
        views: How many views are merged at most, 0 for all.
        filter: Whether what the sampler proposes is judged on the field; if not, it is taken as it
            comes.
        sampler: ``network`` (learned) or ``antipodal`` (model-free), see `SamplerName`; to compare
            with, ``paper`` and ``diffusion``.
        n_candidates: Grasp candidates drawn per update.
        n_grasps: Grasps kept per update.
    """

    camera: str = "wrist_camera"
    second_camera: str = ""
    segmentation: str = word(Segmentation.LABELS, Segmentation)
    execution: str = word(Execution.AUTO, Execution)
    period: float = key(0.5, 0.01, 60.0, "s")
    latency: float = key(0.1, 0.0, 10.0, "s")
    preset: str = word(DEFAULT, field_names())
    max_points: int = key(320, 8, 4096)
    length_scale: float = key(0.3, 0.001, 10.0, "m")
    voxel_size: float = key(0.003, 0.0005, 0.05, "m")
    hidden_side: bool = True
    views: int = key(0, 0, 10000)
    filter: bool = True
    sampler: str = word(SamplerName.NETWORK, sampler_names())
    n_candidates: int = key(800, 1, 100000)
    n_grasps: int = key(192, 1, 10000)


@dc.dataclass
class SensorsConfig:
    """The errors of simulated sensors.

    Attributes:
        error_factor: They are this many times as large as published, those of cameras
            (``camera_noise``) and of joints alike; estimators' constants are not. With 0 steps and
            edges of images are left.
        joints: Encoders and external torques of the arm.
    """

    error_factor: float = key(1.0, 0.0, 10.0)
    joints: JointErrors = dc.field(default_factory=JointErrors)


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
    period: float = key(1.0, 0.01, 60.0, "s")
    resolution: float = key(0.01, 0.001, 0.1, "m")
    margin: float = key(0.005, 0.0, 0.2, "m")


@dc.dataclass
class ReachabilityConfig:
    """The reachability filter between perception and control.

    Attributes:
        period: Time between updates [s].
        method: ``ik``, exact inverse kinematics; to compare with, ``rmm`` (the paper's density of
            reachable poses), ``both`` (exact on what the density lets through) and ``none``
            (nothing is judged).
        symmetric_grasps: Whether a grasp turned by 180 degrees counts as another.
        options: Settings of a method that a package adds (`feasigrasp.plugins`), such as ``space``
            of ``rmm`` and ``both``.
    """

    period: float = key(0.1, 0.001, 10.0, "s")
    method: str = word(EXACT, (EXACT, *plugins("judges")))
    symmetric_grasps: bool = True
    options: Options = dc.field(default_factory=dict)


@dc.dataclass
class ControlConfig:
    """The arm's controller.

    Attributes:
        controller: ``task`` (Riemannian mixture) or ``joint`` (distance field over IK solutions);
            ``nearest`` and ``diffusion`` are baselines, damped tracking of the nearest reachable
            grasp, and the gradient of a learned energy.
        mode: ``safe`` enforces limits and clearances. To compare with, ``paper`` (the paper's law
            as printed) and ``corrected`` (with our corrections) enforce nothing.
        period: Control period [s].
        planning_time: How late a plan takes effect [s], where the cell is simulated; less than
            the time between plans, 0.02 s. The safety filter waits for no plan. Modes that do not
            plan have no use for it.
        speed: Share of the arm's velocity limits that may be used, in (0, 1]; nothing exceeds it,
            plans reckon with it, and lift and shaking take as much longer. Accelerations, and
            with them braking, keep their limits. For ``safe`` mode; on hardware 0.25 by default.
        density: Whether the grasps near the selected one count as well, in ``safe`` mode.
        score: Whether the scores of grasps decide in ``safe`` mode.
        prediction: What plans of ``safe`` mode take the object to do: ``predicted``, to go on as
            the tracker predicts; ``twist``, to keep its twist; ``none``, to stay where it is.
        options: Settings of a controller or mode that a package adds (`feasigrasp.plugins`), such
            as ``law`` of the modes ``paper`` and ``corrected``.
    """

    controller: str = word(ControlSpace.TASK, controller_names())
    mode: str = word(SAFE, mode_names())
    period: float = key(0.005, 0.0005, 0.05, "s")
    planning_time: float = key(0.0, 0.0, 1.0, "s")
    speed: float = key(1.0, 0.01, 1.0, "of the velocity limits")
    density: bool = True
    score: bool = True
    prediction: str = word(PredictionModel.PREDICTED, PredictionModel)
    options: Options = dc.field(default_factory=dict)

    @property
    def safe(self) -> bool:
        """Whether limits and clearances are enforced."""
        return self.mode == SAFE


@dc.dataclass
class ExecutionConfig:
    """Errors between the true and the nominal pose of the hand.

    Attributes:
        position_error: Distance of the true hand from the one that is planned with, in a direction
            drawn from the seed; it stays the same throughout the run [m].
        angle_error: Angle between the two, likewise [rad].
        teleport: Whether the arm is put at the best grasp in reach as soon as there is one, as in
            the paper's static test, instead of moving there.
    """

    position_error: float = key(0.0, 0.0, 0.1, "m")
    angle_error: float = key(0.0, 0.0, 1.0, "rad")
    teleport: bool = False


def _default_plant() -> MultibodyPlantConfig:
    return MultibodyPlantConfig(
        time_step=0.0025,
        # Sampled outputs would make every step an update of the whole diagram's state.
        use_sampled_output_ports=False,
        contact_model="hydroelastic_with_fallback",
        discrete_contact_approximation="lagged",
    )


@dc.dataclass
class Scenario:
    """Everything that a run depends on.

    Attributes:
        random_seed: Seed of all that the scenario leaves to chance.
        simulation_duration: Length of the run [s]; a run ends earlier when the grasp is over.
        simulator_config: Drake's simulator settings.
        plant_config: Drake's plant settings.
        directives: The robot cell; see ``models/iiwa/cell.dmd.yaml``. Paths start at the scenario's
            file, here and in every other key.
        cell: Table height, clearance to the table, and obstacles.
        arm: ``iiwa7``, ``iiwa14``, ``panda``, ``fr3``, ``ur5e``, ``xarm7``, or a file of
            ``feasigrasp arm``.
        gripper: The hand: ``EZGripper``, ``WSG_50``, ``suction``, or a YAML file with attributes of
            `ParallelGripper`, or with ``kind: suction`` of `SuctionCup`; its model is made of them.
        cameras: Cameras by name.
        camera_noise: By camera, errors of its depth image; ``{wrist_camera: {}}`` gives it those of
            a RealSense D435, entries as in `DepthNoise` change them, and those of `HandEyeError`
            move the camera from its calibrated pose. A camera not named has no errors,
            and ``{}`` takes away those of a scenario that it is applied to.
        sensors: Size of the errors of all simulated sensors.
        q_start: Joint positions at the start [deg]; empty for the arm's ``home``.
        object: The object.
        motion: How it moves; ``!BezierPath {speed: 0.15}`` for one that stops and turns.
        carrier: What carries the object: how firmly, when it lets go, how it looks.
        distractor: Another object beside it.
        tracker: How its pose is measured.
        perception: Views, distance field, grasps.
        scene: Surroundings that grasps keep clear of.
        reachability: Reachability filter.
        control: Controller.
        execution: Errors of the hand's place.
        grasp: Closing, letting go, lifting, shaking, holding.
        parts: Parts of one's own: ``sampler``, ``controller``, ``tracker``, ``predictor``,
            ``perception``, ``segmentation``, ``motion``, each with the ``name`` of its class or
            function, ``package.module:Name``, and keyword arguments as ``options``.
        faults: What goes wrong, and when, e.g. ``!PoseNan {start: 2, duration: 0.5}``.
    """

    random_seed: int = key(0, *SEED)
    simulation_duration: float = key(30.0, 0.001, 100000.0, "s")
    simulator_config: SimulatorConfig = dc.field(
        default_factory=lambda: SimulatorConfig(max_step_size=0.01)
    )
    plant_config: MultibodyPlantConfig = dc.field(default_factory=_default_plant)
    directives: list[ModelDirective] = dc.field(default_factory=list)
    cell: CellConfig = dc.field(default_factory=CellConfig)
    arm: str = "iiwa7"
    gripper: str = PACKAGED
    cameras: dict[str, CameraConfig] = dc.field(default_factory=dict)
    camera_noise: dict[str, dict[str, float]] = dc.field(default_factory=dict)
    sensors: SensorsConfig = dc.field(default_factory=SensorsConfig)
    q_start: list[float] = key([], *_JOINTS)
    object: ObjectConfig = dc.field(default_factory=ObjectConfig)
    motion: typing.Union[MotionConfig, BezierPath] = dc.field(  # noqa: UP007 - see above
        default_factory=MotionConfig
    )
    carrier: CarrierConfig = dc.field(default_factory=CarrierConfig)
    distractor: DistractorConfig = dc.field(default_factory=DistractorConfig)
    tracker: TrackerConfig = dc.field(default_factory=TrackerConfig)
    perception: PerceptionConfig = dc.field(default_factory=PerceptionConfig)
    scene: SceneConfig = dc.field(default_factory=SceneConfig)
    reachability: ReachabilityConfig = dc.field(default_factory=ReachabilityConfig)
    control: ControlConfig = dc.field(default_factory=ControlConfig)
    execution: ExecutionConfig = dc.field(default_factory=ExecutionConfig)
    grasp: GraspSequenceConfig = dc.field(default_factory=GraspSequenceConfig)
    parts: dict[str, PartConfig] = dc.field(default_factory=dict)
    faults: list[AnyFault] = dc.field(default_factory=list)

    def __post_init__(self) -> None:
        """Checks the types of the entries.

        Raises:
            ScenarioError: One has another type, or the seed is negative.
        """
        check_fields(self, ScenarioError)
        if self.random_seed < 0:
            raise ScenarioError(f"Scenario.random_seed = {self.random_seed}; give 0 or more")

    @property
    def start(self) -> Array:
        """Joint positions at the start [rad]."""
        return np.deg2rad(self.q_start) if self.q_start else load_arm(self.arm).home

    @property
    def sequence(self) -> GraspSequenceConfig:
        """The section ``grasp`` at the speed of the arm."""
        return self.grasp.at_speed(self.control.speed)

    @property
    def controller_name(self) -> str:
        """Name of the controller: a `ControlSpace`, or that of a custom part."""
        own = self.parts.get(Part.CONTROLLER)
        return str(self.control.controller) if own is None else own.name
