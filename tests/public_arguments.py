"""Arguments with which every public function can be called, and what is public."""

import inspect
from dataclasses import fields
from enum import Enum
from importlib import import_module

import numpy as np
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from feasigrasp import Result
from feasigrasp.models.clouds import FusedCloud
from feasigrasp.models.clouds.checks import ViewRecord
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.control import (
    HorizonOptions,
    ProgramOptions,
    SafetyFilter,
    SafetyOptions,
)
from feasigrasp.models.control.horizon.law import HorizonPlan
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import MovingObject, ObstacleGrid
from feasigrasp.models.grasps import AntipodalSampler, GraspSet, NetworkSampler, Perception
from feasigrasp.models.grasps.sequence import GraspSequenceConfig
from feasigrasp.models.objects import HarmonicMotion, load_object
from feasigrasp.models.objects.pose_filter import empty_state
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.objects.tracking import TrackerConfig
from feasigrasp.models.reach import InterceptionOptions, Reachability
from feasigrasp.models.reach.interception import Situation
from feasigrasp.models.robot import IIWA_7, ParallelGripper, SuctionCup
from feasigrasp.models.sensors import MATERIALS, CameraErrors, DepthNoise
from feasigrasp.models.shape import complete_shape, fit_gpdf, fit_scene
from feasigrasp.models.tracking import Camera, FieldTrack, ObjectView, SequenceTracker
from feasigrasp.recordings import CameraInfo, DepthFrame, read_depth_folder, recorded
from feasigrasp.runs.run import crash_record
from feasigrasp.scenario import Scenario
from feasigrasp.systems import (
    GPJointController,
    GraspController,
    GripperSequencer,
    ObjectTracker,
    RMMTaskController,
    StationConfig,
    Subsystems,
)
from feasigrasp.systems.grasp_controller import ControllerInputs
from tools.make_docs import faces

#: Public, but not called with arguments of a user's.
NOT_WALKED = {
    "Station.GetInputPort": "Drake's, and so are its errors",
    "Station.GetOutputPort": "likewise",
    "Arm": "made from files; wrong ones are in tests/models/robot/test_arms.py",
    "DynamicGrasp": "made by make_dynamic_grasp",
    "ControllerInputs": "made by GraspController at every tick",
    "ObjectMotion": "abstract",
    "ObjectMotion.state": "abstract; that of HarmonicMotion is walked",
    "GraspController.velocity": "abstract; those of the two controllers are walked",
    "GraspController.update": "abstract; those of the two controllers are walked",
}


def public_callables():
    """Functions, constructors and public methods by name."""
    found = {}
    for face in faces():
        module = import_module(face)
        for name in module.__all__:
            thing = getattr(module, name)
            name = thing.__name__ if inspect.isclass(thing) else name  # a former name: once
            if inspect.ismodule(thing):
                functions = inspect.getmembers(thing, inspect.isfunction)
                found |= {
                    f"{name}.{key}": function
                    for key, function in functions
                    if function.__module__ == thing.__name__ and not key.startswith("_")
                }
            elif inspect.isclass(thing) and not issubclass(thing, Enum):
                found[name] = thing
                found |= {f"{name}.{key}": method for key, method in public_methods(thing)}
            elif inspect.isfunction(thing):
                found[name] = thing
    return {name: thing for name, thing in found.items() if name not in NOT_WALKED}


def public_methods(cls):
    for base in reversed(cls.__mro__):
        if base.__module__.startswith("feasigrasp"):
            for key, value in vars(base).items():
                function = getattr(value, "__func__", value)
                if inspect.isfunction(function) and (key[0] != "_" or key == "__call__"):
                    yield key, function


def ball(count=200, radius=0.04):
    """Points spread evenly over a sphere."""
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * i / count), np.pi * (1.0 + 5.0**0.5) * i
    x, y = np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar)
    return radius * np.column_stack([x, y, np.cos(polar)])


class Still(GraspController):
    """A controller of one's own."""

    def velocity(self, memory, inputs):
        return np.zeros(7)


class Examples:
    """Instances by the name of their class; arguments by ``Function.parameter`` or parameter."""

    def __init__(self, folder):
        rng = np.random.default_rng(0)
        cloud, poses = ball(), se3.random_pose(rng, 5)
        self.gpdf = fit_gpdf(cloud)
        seen = FusedCloud.empty(0.003, smooth=True).merged(cloud[cloud[:, 2] > 0], [0, 0, 0.4])
        grasp = np.diag([1.0, -1.0, -1.0, 1.0])
        grasps = GraspSet(np.stack([grasp] * 3), np.full(3, 0.08), np.ones(3), {"colour": 1})
        gripper, reach = ParallelGripper(), Reachability()
        camera = Camera((280.0, 280.0, 159.5, 119.5), 320, 240, 0.07, 0.005)
        X_WC = se3.make_pose(grasp[:3, :3], [0.0, 0.0, 0.4])
        view = ObjectView(camera, X_WC, cloud, np.full((240, 320), 0.4))
        grid = ObstacleGrid(np.ones((3, 3, 3), dtype=np.float32), np.array([0.0, 0, 0, 0.1, 1.0]))
        q, twist, K = np.full(7, 0.3), np.full(6, 0.1), np.diag([280.0, 280.0, 1.0])
        now = Situation(0.0, q, np.zeros(7), np.eye(4), twist)
        motion = HarmonicMotion(*np.ones((4, 3)), 1.0, 0.0, np.ones(3), 0.1)
        scene = fit_scene(cloud, [0.0, 0.0, 1.0])
        controller = Still(reach)
        context = controller.CreateDefaultContext()
        controller.GetInputPort("position").FixValue(context, q)
        plant, info = MultibodyPlantConfig(), CameraInfo((280.0, 280.0, 159.5, 119.5))
        picture = np.full((240, 320), 400, dtype=np.uint16)
        frame = DepthFrame(0.0, 0, picture, np.zeros((240, 320, 3), dtype=np.uint8))
        recording = folder / "recording"
        list(recorded(recording, info, [frame]))
        image, sequence = recording / "depth" / "000000.png", read_depth_folder(recording)
        files = {"cloud": folder / "cloud.npy"}
        np.save(files["cloud"], cloud)
        mesh = load_object("ball")
        self.instances = {
            "CameraErrors": CameraErrors(DepthNoise(), 0, (20, 30)),
            "DepthNoise": DepthNoise(),
            "Material": MATERIALS["shiny"],
            "FusedCloud": FusedCloud(cloud, cloud, 0.003, 1, False, cloud, np.ones(len(cloud))),
            "HorizonOptions": HorizonOptions(),
            "InterceptionOptions": InterceptionOptions(),
            "ProgramOptions": ProgramOptions(),
            "SafetyFilter": SafetyFilter(gripper=gripper),
            "Situation": now,
            "SafetyOptions": SafetyOptions(),
            "AntipodalSampler": AntipodalSampler(),
            "GraspSet": grasps,
            "NetworkSampler": NetworkSampler(),
            "Perception": Perception(seen, self.gpdf, grasps, gripper, np.ones(3), 0, np.ones(3)),
            "HarmonicMotion": motion,
            "ObjectMotion": motion,
            "RigidObject": mesh,
            "Reachability": reach,
            "Arm": IIWA_7,
            "ParallelGripper": gripper,
            "SuctionCup": SuctionCup(),
            "Gpdf": self.gpdf,
            "CompletedField": complete_shape(seen, learnt=False),
            "SceneField": scene,
            "Camera": camera,
            "FieldTrack": FieldTrack(0.0, np.eye(4)),
            "ObjectView": view,
            "SequenceTracker": SequenceTracker(),
            "Scenario": Scenario(),
            "StationConfig": StationConfig(plant),
            "Result": Result(crash_record(Scenario(), "", ""), {}, np.zeros(2), np.zeros((3, 2))),
            "CameraInfo": info,
            "DepthFolder": sequence,
            "DepthFrame": frame,
            "ControllerInputs": ControllerInputs(controller, context),
            "GraspController": controller,
            "GPJointController": GPJointController(reach),
            "RMMTaskController": RMMTaskController(reach),
            "GripperSequencer": GripperSequencer(GraspSequenceConfig(), gripper),
            "ObjectTracker": ObjectTracker(),
        }
        self.values = {
            # clouds
            "points": cloud, "directions": cloud, "p_OC": np.array([0.0, 0.0, 0.4]),
            "outline": Outline(np.zeros((0, 3)), np.zeros((0, 3))), "focal_length": 280.0,
            "intrinsics": K, "rng": rng, "voxel_size": 0.003,
            "gone": np.zeros(len(cloud), dtype=bool), "crop": (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0),
            "viewpoint": np.array([0.0, 0.0, 0.4]), "filename": files["cloud"],
            "points_C": cloud + [0.0, 0.0, 0.4], "points_W": cloud,
            "Camera.rays.u": np.ones(4), "Camera.rays.v": np.ones(4), "views": ViewRecord(),
            # control
            "options": SafetyOptions(), "gripper": gripper, "q": q, "qd_preferred": q, "qd": q,
            "qd_last": q, "J": np.ones((6, 7)), "V": twist, "obstacles": grid,
            "moving": MovingObject(grid, np.eye(4), np.zeros(6)),
            # geometry
            "v": twist, "X": poses, "w": twist[:3], "R": poses[:, :3, :3], "z": np.eye(3),
            "wxyz": np.ones(4), "p": np.ones((5, 3)), "n": 2, "X_WB": poses[0], "V_WB": twist,
            "dt": 0.1, "X_WA": poses[0], "share": 0.5,
            # grasps
            "X_OG": grasps.X_OG, "score": grasps.score,
            "rejected": {"colour": 1}, "keep": np.array([0, 1]), "reason": "colour",
            "dropped": {"colour": 1}, "other": grasps, "grasps": grasps, "gpdf": self.gpdf,
            "payload_score": np.ones(3), "on_object": np.arange(4), 
            "prior": np.full((3, 2), 0.5), "table": np.array([0.0, 0.0, 1.0, 0.1]),
            "least_score": 0.5, "mass": 0.3, "near": 0.0, "down": np.array([0.0, 0.0, -1.0]),
            "rows": np.s_[2:], "columns": np.s_[:9], "Camera.decimated.factor": 2,
            "DepthFolder.label": 1, "read_mask.label": 1, "read_depth_folder.label": 1,
            "captured_points.label": 1,
            # ik
            "X_WF": poses, "psi": np.zeros(5), "u": np.full((5, 7), 0.5),
            "path": folder / "saved.npz",
            # objects
            "t": 0.5, "name": "network", "mesh": mesh.mesh, "density": 300.0,
            "name_or_path": "ball", "load_object.mass": None,
            # reach
            "X_WG": poses, "X_WO": np.eye(4), "V_WO": twist,
            "Situation.v": q, "Situation.time": 0.0, "ahead": np.array([0.1, 0.2]),
            "InterceptionOptions.times.now": 0.5, "find_interceptions.score": np.ones(5),
            "find_interceptions.X_OG": poses, "feasible_poses.X_OG": poses,
            "feasible_poses.options": InterceptionOptions(), "feasible_poses.ahead": 0.5,
            "feasible_poses.width": np.full(5, 0.05), "SafetyOptions.of.arm": IIWA_7,
            "find_interceptions.options": InterceptionOptions(),
            "feasible_grasps.options": InterceptionOptions(), "present": (2, 0.5),
            "RMMTaskController.options": HorizonOptions(),
            "GPJointController.options": HorizonOptions(),
            "ReachabilityFilter.options": InterceptionOptions(),
            "MotionPredictor.function": lambda *given: None,
            "FeasiblePoses.options": InterceptionOptions(), "FeasiblePoses.ahead": 0.5,
            "ProgramOptions.steps": (0.02,),
            "now": now,
            "motion": MotionEstimate(empty_state(), 0.0), "kept_before": np.array([1]),
            "reachability": reach,
            # robot
            "X_FT": np.eye(4), "ndim": 1, "opening": 0.05, "Arm.braking_rate.speed": 0.9,
            "acceleration_share": 0.9,
            # shape
            "x": cloud, "starts": cloud, "Gpdf.ray_exits.directions": -cloud,
            "CompletedField.ray_exits.directions": -cloud, "max_length": 0.1,
            "start_length": 0.002, "poses": poses, "body_points": ball(9), "far": 0.1,
            "cloud": seen, "noise_variance": 0.0025, "margin": 0.01,
            # sensors
            "noise": DepthNoise(), "CameraErrors.seed": 0, "CameraErrors.size": (20, 30),
            "factor": 2.0,
            "CameraErrors.fixed.depth": np.full((20, 30), 0.4), "material": MATERIALS["shiny"],
            "CameraErrors.fixed.poses": (np.eye(4), np.eye(4)),
            "CameraErrors.fixed.on_object": np.ones((20, 30), dtype=bool),
            # tracking
            "before": FieldTrack(), "view": view, "time": 1.0, "silence": 1.0,
            "second": lambda: None,
            # scenario and systems
            "load_scenario.scenario": "ReachCircular",
            "Result.write_log.filename": folder / "log.npz",
            "depth": image, "DepthNoise.apply.depth": np.full((20, 30), 0.4), "file": image,
            "captured_points.camera": recording / "camera.json", "mask": image, "rate": 30.0,
            "box": (10, 10, 90, 90), "given": recording / "camera.json", "shape": (240, 320),
            "folder": recording, "recorded.folder": folder / "other", "recorded.camera": info,
            "frames": [frame], "k": 0, "grid": grid, "replay": folder / "replay.html",
            "width": 320, "height": 240, "GraspSet.width": grasps.width,
            "filter_grasps.width": grasps.width, "ghost": Scenario(),
            "run.keep": lambda record: None, "line": None, "live": None, "size": (320, 240),
            "StationConfig.q_start": q, "GraspController.memory": None,
            "scenario": Scenario(), "config": GraspSequenceConfig(),
            "ObjectTracker.config": TrackerConfig(), "Station.config": StationConfig(plant),
            "obj": mesh, "Station.motion": motion, "label": 3, "camera": camera,
            "sampler": AntipodalSampler(), "period": 0.1, "memory": HorizonPlan(),
            "inputs": ControllerInputs(controller, context), "context": context,
            "GraspController.safety": SafetyOptions(),
            "plant": plant,
            "groups": ("task",), "planning_time": 0.02,
        }  # fmt: skip
        for system in fields(Subsystems):
            self.values[f"Subsystems.{system.name}"] = controller
        builder = DiagramBuilder()
        builder.AddSystem(Still(reach))
        self.values["Subsystems.station"] = builder.Build()

    def call(self, name, function):
        """What is called, a method bound to its instance, and arguments by name."""
        owner, _, method = name.partition(".")
        instance = self.instances.get(owner)
        if method and owner != "se3":
            if instance is None:
                assert list(inspect.signature(function).parameters) == ["self"], name
                return function, {}
            function = getattr(instance, method)
        found = {}
        for parameter in inspect.signature(function).parameters.values():
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            found[parameter.name] = self.value(name, parameter, None if method else instance)
        return function, found

    def value(self, name, parameter, instance):
        own, key = f"{name}.{parameter.name}", parameter.name
        if own in self.values:
            return self.values[own]
        given = getattr(instance, key, None)
        if given is None:
            given = self.values.get(key, parameter.default)
        assert given is not parameter.empty, f"{own}: give an example in {__name__}"
        return given
