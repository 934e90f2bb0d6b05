from .models.clouds.files import read_cloud as read_cloud
from .models.control.safety.safe_velocity import SafetyFilter as SafetyFilter
from .models.control.safety.safe_velocity import SafetyOptions as SafetyOptions
from .models.grasps.filter import filter_grasps as filter_grasps
from .models.grasps.grasp_set import GraspSet as GraspSet
from .models.grasps.perceive import Perception as Perception
from .models.grasps.perceive import perceive as perceive
from .models.grasps.samplers import make_sampler as make_sampler
from .models.objects.motion import HarmonicMotion as HarmonicMotion
from .models.objects.motion import ObjectMotion as ObjectMotion
from .models.objects.rigid_object import load_object as load_object
from .models.reach.reachability import Reachability as Reachability
from .models.robot.gripper import ParallelGripper as ParallelGripper
from .models.shape.completion import complete_shape as complete_shape
from .models.shape.gpdf import Gpdf as Gpdf
from .models.shape.gpdf import fit_gpdf as fit_gpdf
from .models.tracking.tracker import SequenceTracker as SequenceTracker
from .recordings.folder import read_depth_folder as read_depth_folder
from .runs.run import Result as Result
from .runs.run import run as run
from .scenario.files import load_scenario as load_scenario
from .scenario.schema import Scenario as Scenario
from .systems.dynamic_grasp import make_dynamic_grasp as make_dynamic_grasp
from .systems.grasp_controller import ControllerInputs as ControllerInputs
from .systems.grasp_controller import GraspController as GraspController
from .systems.reachability_filter import FeasiblePoses as FeasiblePoses

__version__: str
