"""The sampler runs once per field, whoever reads its grasps and however often."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.grasp_sampler import GraspSampler
from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
from feasigrasp.systems.ports import to_value


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
    context = fixed_context(dut, gpdf=to_value(None))
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
    perception = builder.AddSystem(PointCloudToGPDF(0.5, views_per_side=9))
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


def test_at_rest_it_passes_over_fields_and_then_takes_the_last():
    fields, sampler = [fit_gpdf(sphere() + 1e-4 * k) for k in range(10)], CountingSampler()
    sets = on_new_fields(GraspSampler(sampler, rest=0.5), fields, period=0.12, settled=False)
    assert [fields.index(gpdf) for gpdf in sampler.fields] == [0, 4, 8]
    assert sets[4] is sets[0] is not sets[5]


def test_an_error_of_the_sampler_is_not_swallowed(fixed_context):
    def broken(gpdf):
        raise RuntimeError("no grasps today")

    dut = GraspSampler(broken)
    context = fixed_context(dut, gpdf=AbstractValue.Make(fit_gpdf(sphere())))
    with pytest.raises(RuntimeError, match="no grasps today"):
        dut.get_output_port().Eval(context)


def on_new_fields(dut, fields, period=0.5, settled=True):
    """The grasps for fields that come one after the other, ``period`` apart."""
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    sets = []
    for k, gpdf in enumerate(fields):
        dut.GetInputPort("gpdf").FixValue(context, AbstractValue.Make(gpdf))
        sets.append(dut.get_output_port().Eval(context))
        simulator.AdvanceTo(period * (k + 1))
        now = dut.get_output_port().Eval(context)
        assert now is sets[-1] or not settled, "nothing new, nothing changes"
    return sets


def test_grasps_keep_their_identity_from_field_to_field():
    rng, gripper = np.random.default_rng(1), ParallelGripper()
    fields = [fit_gpdf(sphere() + rng.normal(scale=5e-4, size=(600, 3))) for _ in range(3)]
    sampler = AntipodalSampler(n_candidates=200)
    sets = on_new_fields(GraspSampler(sampler, gripper), fields)
    for before, after in zip(sets, sets[1:], strict=False):
        same = np.isin(after.id, before.id)
        assert same.mean() > 0.5
        poses = dict(zip(before.id, before.X_OG, strict=True))
        kept = [np.array_equal(poses[i], X) for i, X in zip(after.id, after.X_OG, strict=True)
                if i in poses]  # fmt: skip
        assert np.mean(kept) > 0.7
    # A fresh system on the last field alone has other grasps and its own numbers.
    alone = on_new_fields(GraspSampler(sampler, gripper), fields[-1:])[0]
    assert set(alone.id) == set(range(len(alone)))


def test_the_output_is_a_function_of_field_and_state():
    """Evaluated twice, or not at all before the next update: the same grasps."""
    fields = [fit_gpdf(sphere(radius=r)) for r in (0.03, 0.0303)]
    gripper, sampler = ParallelGripper(), AntipodalSampler(n_candidates=80)
    watched = on_new_fields(GraspSampler(sampler, gripper), fields)[-1]
    dut = GraspSampler(sampler, gripper)
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    for k, gpdf in enumerate(fields):
        dut.GetInputPort("gpdf").FixValue(context, AbstractValue.Make(gpdf))
        simulator.AdvanceTo(0.5 * (k + 1))
    unwatched = dut.get_output_port().Eval(context)
    np.testing.assert_array_equal(unwatched.X_OG, watched.X_OG)
    np.testing.assert_array_equal(unwatched.id, watched.id)


def test_a_sampler_that_finds_no_grasp_set_is_told_what_to_return(fixed_context):
    dut = GraspSampler(lambda gpdf: None)
    context = fixed_context(dut, gpdf=AbstractValue.Make(fit_gpdf(sphere())))
    with pytest.raises(GraspError, match="returned NoneType; have it return a GraspSet"):
        dut.get_output_port().Eval(context)


def test_what_cannot_be_called_is_no_sampler():
    with pytest.raises(GraspError, match="sampler is a LeafSystem; give a function"):
        GraspSampler(LeafSystem())
