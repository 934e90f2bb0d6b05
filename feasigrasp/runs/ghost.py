"""A translucent second arm in a replay, for the comparison of modes."""

from contextlib import suppress

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Rgba, Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.arrays import Array
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import station_config
from feasigrasp.systems.station.cell_models import add_cell, robot_instances

#: Meshcat path of everything that it shows.
PREFIX = "/drake/ghost"


def ghost_of(scenario: Scenario, until: float) -> tuple[Array, Array]:
    """The true trajectory of the arm in a scenario until a time [s], or a failed simulation.

    It is times (n,) [s], and joint positions (n, 7) [rad] at them.
    """
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    simulator.set_target_realtime_rate(0.0)
    with suppress(RuntimeError):  # the solver failed
        simulator.AdvanceTo(until)
    log = diagram.GetSubsystemByName("log(arm)").FindLog(simulator.get_context())
    return log.sample_times().copy(), np.split(log.data(), 2)[0].T.copy()


def show_ghost(meshcat: Meshcat, scenario: Scenario, times: Array, q: Array, rate: float) -> None:
    """Draws a trajectory into the recording of a Meshcat, translucent, with an open hand.

    The scenario has the arm in its cell; ``rate`` is in pictures per second.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    config = station_config(scenario)
    add_cell(plant, config)
    plant.Finalize()
    # Its collision geometry: the visual geometry has colors of its own.
    color = Rgba(0.45, 0.25, 0.85, 0.35)
    params = MeshcatVisualizerParams(role=Role.kProximity, default_color=color, prefix=PREFIX)
    shown = MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context, arm = plant.GetMyContextFromRoot(root), plant.GetModelInstanceByName(config.arm.name)
    for time in np.arange(0.0, times[-1], 1.0 / rate):
        plant.SetPositions(context, arm, q[np.searchsorted(times, time)])
        root.SetTime(time)
        shown.ForcedPublish(shown.GetMyContextFromRoot(root))
    robot = robot_instances(plant, config.arm)
    for instance in map(ModelInstanceIndex, range(plant.num_model_instances())):
        if instance not in robot:  # what stands still is there already
            meshcat.Delete(f"{PREFIX}/{plant.GetModelInstanceName(instance)}")
