"""What the controller plans, in a process of its own: the plan is the one it would make here."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.scenario.files import dump_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_controller
from feasigrasp.systems.remote.remote_stage import end_processes
from feasigrasp.systems.stages.remote import PROMPT_LATENCY, make_planner_stage
from tests.pipeline import scenario

Q = np.array([0.1, -0.7, 0.1, -1.6, 0.1, 1.4, 0.1])
X_WO = RigidTransform([0.5, 0.0, 0.5])
#: The object drifts away along x [m/s].
V_WO = SpatialVelocity([0.0, 0.0, 0.0], [0.05, 0.0, 0.0])


def fix(system, context, X_WH):
    """Gives a system two grasps, one 5 cm beside the other."""
    X_OG = X_WO.inverse().GetAsMatrix4() @ X_WH
    beside = X_OG @ RigidTransform([0.0, 0.05, 0.0]).GetAsMatrix4()
    grasps = GraspSet(np.stack([beside, X_OG]), np.zeros(2), np.ones(2))
    for name, value in {"grasps": grasps, "object_pose": X_WO, "object_velocity": V_WO}.items():
        system.GetInputPort(name).FixValue(context, AbstractValue.Make(value))
    system.GetInputPort("position").FixValue(context, Q)


@pytest.mark.parametrize("space", ["task", "joint"])
def test_elsewhere_plans_as_here(space):
    setting = scenario(text=f"{{control: {{controller: {space}}}}}")
    reachability = Reachability(load_gripper(setting.gripper))
    here = make_controller(setting, reachability)
    there = make_controller(setting, reachability)
    stage = make_planner_stage(dump_scenario(setting))
    X_WH, _ = pose_and_jacobian(Q, reachability.gripper.X_FG)
    simulators = [Simulator(here), Simulator(stage)]
    for simulator in simulators:
        fix(simulator.get_system(), simulator.get_mutable_context(), X_WH)
        simulator.AdvanceTo(0.35)
    follows = there.CreateDefaultContext()
    fix(there, follows, X_WH)
    plan = stage.get_output_port().Eval(simulators[1].get_context())
    there.GetInputPort("plan").FixValue(follows, AbstractValue.Make(plan))
    follows.SetTime(0.35)
    commands = [
        system.GetOutputPort("commanded_velocity").Eval(context)
        for system, context in ((here, simulators[0].get_context()), (there, follows))
    ]
    np.testing.assert_array_equal(*commands)
    assert np.abs(commands[0]).max() > 0.01


def test_who_is_told_a_plan_makes_none():
    """The pipeline with a planner: the controller here never plans, and its arm moves."""
    diagram = make_dynamic_grasp(scenario(text="{perception: {execution: processes}}"))
    controller = diagram.subsystems.controller
    planned = []
    controller.update = lambda memory, inputs: planned.append(inputs)
    simulator = Simulator(diagram)
    context = simulator.get_context()
    before = controller.memory(controller.GetMyContextFromRoot(context))
    # Grasps of the view at the start are there after 0.1 s; at 0.2 s the planner is posted them.
    simulator.AdvanceTo(0.2 + PROMPT_LATENCY - 1e-3)
    assert controller.memory(controller.GetMyContextFromRoot(context)).X_OG is None
    simulator.AdvanceTo(0.35)
    after = controller.memory(controller.GetMyContextFromRoot(context))
    velocity = controller.GetOutputPort("commanded_velocity")
    speed = np.abs(velocity.Eval(controller.GetMyContextFromRoot(context))).max()
    end_processes(diagram)
    assert before.X_OG is None and after.X_OG is not None and speed > 0.01
    assert not planned


def test_a_controller_that_is_handed_over_plans_where_it_is():
    setting = scenario(text="{perception: {execution: processes}}")
    own = make_controller(setting, Reachability(load_gripper(setting.gripper)))
    diagram = make_dynamic_grasp(setting, controller=own)
    end_processes(diagram)
    assert not diagram.HasSubsystemNamed("planner")
