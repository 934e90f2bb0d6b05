"""A robot cell with inputs set by hand, for tests of the station."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.systems.from_scenario import make_station

FILE = diagram_path("dynamic.scenarios.yaml")
OPEN = ParallelGripper().max_opening
HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])


def scenario(*, cameras=False, mode="safe", model="mug"):
    """A cell with an ideal camera, if any."""
    ideal = "camera_noise: {}, sensors: {error_factor: 0}"
    text = f"{{object: {{model: {model}}}, control: {{mode: {mode}}}, {ideal}}}"
    result = load_scenario(FILE, "ReachCircularMocap", text)
    if not cameras:
        result.cameras = {}
    return result


class Cell:
    """A station with a simulator whose inputs can be changed; trials get fresh contexts."""

    def __init__(self, config):
        self.scenario = config
        self.motion = make_motion(config)
        self.station = make_station(config)

    def start(self, q=HOME):
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self.fix("arm.desired_state", np.r_[q, np.zeros(7)])
        self.fix("gripper.position", [OPEN])
        self.fix("object.hold", [1.0])
        return self

    def fix(self, name, value):
        self.station.GetInputPort(name).FixValue(self.context, value)

    def advance(self, t):
        self.simulator.AdvanceTo(t)

    def read(self, name):
        value = self.station.GetOutputPort(name).Eval(self.context)
        return value.copy() if isinstance(value, np.ndarray) else value

    def object_pose(self):
        return RigidTransform(self.read("object.pose"))

    def put_object(self, X_WO):
        plant = self.station.plant
        plant.SetFreeBodyPose(
            plant.GetMyMutableContextFromRoot(self.context), self.station.object_body, X_WO
        )
