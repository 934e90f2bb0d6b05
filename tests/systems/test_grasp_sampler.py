"""The sampler runs once per field, whoever reads its grasps and however often."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.models.antipodal_sampler import AntipodalSampler
from feasigrasp.models.gpdf import fit_gpdf
from feasigrasp.models.grasps import GraspSet
from feasigrasp.systems.grasp_sampler import GraspSampler
from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF


def sphere(n=600, radius=0.03):
    p = np.random.default_rng(0).normal(size=(n, 3))
    return radius * p / np.linalg.norm(p, axis=1, keepdims=True)


class CountingSampler:
    def __init__(self):
        self.fields = []

    def __call__(self, gpdf):
        self.fields.append(gpdf)
        return GraspSet(np.eye(4)[None], np.array([0.05]), np.ones(1), {"a reason": 3})


class Reader(LeafSystem):
    """Reads the grasps at control rate."""

    def __init__(self, period):
        super().__init__()
        self.read = []
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context, discrete_state):
        self.read.append(self._grasps.Eval(context))


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(GraspSampler(CountingSampler()))
    assert (list(inputs), list(outputs)) == documented_ports(GraspSampler)


def test_without_a_field_there_are_no_grasps_and_a_reason(fixed_context):
    sampler = CountingSampler()
    dut = GraspSampler(sampler)
    context = fixed_context(dut, gpdf=AbstractValue.Make(None))
    grasps = dut.get_output_port().Eval(context)
    assert len(grasps) == 0
    assert grasps.rejected == {"object not seen": 1}
    assert sampler.fields == []


def test_grasps_and_reasons_of_the_sampler_are_passed_on(fixed_context):
    gpdf = fit_gpdf(sphere())
    dut = GraspSampler(AntipodalSampler(n_candidates=80))
    context = fixed_context(dut, gpdf=AbstractValue.Make(gpdf))
    grasps = dut.get_output_port().Eval(context)
    direct = AntipodalSampler(n_candidates=80)(gpdf)
    np.testing.assert_array_equal(grasps.X_OG, direct.X_OG)
    assert grasps.rejected == direct.rejected
    # On a sphere every grasp closes over the diameter.
    assert len(grasps) > 0
    np.testing.assert_allclose(grasps.width, 0.06, atol=0.004)
    np.testing.assert_allclose(grasps.X_OG[:, :3, 3], 0.0, atol=0.005)


def test_it_is_called_once_per_new_field_not_once_per_reader():
    sampler = CountingSampler()
    builder = DiagramBuilder()
    perception = builder.AddSystem(PointCloudToGPDF(0.5))
    dut = builder.AddSystem(GraspSampler(sampler))
    reader = builder.AddSystem(Reader(0.005))
    builder.Connect(perception.GetOutputPort("gpdf"), dut.GetInputPort("gpdf"))
    builder.Connect(dut.get_output_port(), reader.GetInputPort("grasps"))
    for name in ("point_cloud", "object_pose", "camera_pose"):
        builder.ExportInput(perception.GetInputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    cloud = PointCloud(600)
    cloud.mutable_xyzs()[:] = sphere().T
    diagram.GetInputPort("point_cloud").FixValue(context, cloud)
    diagram.GetInputPort("object_pose").FixValue(context, RigidTransform())
    diagram.GetInputPort("camera_pose").FixValue(context, RigidTransform([0, 0, 0.5]))
    simulator.AdvanceTo(2.0)
    assert len(reader.read) == 400
    assert len(sampler.fields) == len({id(field) for field in sampler.fields}) == 4
    assert len({id(grasps) for grasps in reader.read}) == 4  # read, never copied


def test_an_error_of_the_sampler_is_not_swallowed(fixed_context):
    def broken(gpdf):
        raise RuntimeError("no grasps today")

    dut = GraspSampler(broken)
    context = fixed_context(dut, gpdf=AbstractValue.Make(fit_gpdf(sphere())))
    with pytest.raises(RuntimeError, match="no grasps today"):
        dut.get_output_port().Eval(context)
