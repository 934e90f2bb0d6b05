"""An object in a Drake plant keeps its mass, its inertia and its hollow shape."""

import numpy as np
import pytest
import trimesh
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    ProximityProperties,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.systems.station.object_model import add_object

CONFIG = MultibodyPlantConfig(
    time_step=0.002,
    contact_model="hydroelastic_with_fallback",
    discrete_contact_approximation="lagged",
)


def plant_with(obj, folder, **options):
    """A plant with an object in it: builder, plant, scene graph and the object's body."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(CONFIG, builder)
    instance = add_object(plant, obj, directory=folder, **options)
    return builder, plant, scene_graph, plant.GetBodyByName("object", instance)


def compliant_ball(plant, radius, mass=0.02):
    body = plant.AddRigidBody(
        "ball", plant.AddModelInstance("ball"), SpatialInertia.SolidSphereWithMass(mass, radius)
    )
    properties = ProximityProperties()
    AddCompliantHydroelasticProperties(radius / 2, 1e6, properties)
    AddContactMaterial(20.0, None, CoulombFriction(0.5, 0.5), properties)
    plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(radius), "ball", properties)
    return body


def test_body_has_the_mass_and_inertia_of_the_object(tmp_path):
    obj = load_object("mug")
    _, plant, _, body = plant_with(obj, tmp_path, friction=0.6)
    plant.Finalize()
    assert body.is_floating_base_body()
    M = body.default_spatial_inertia()
    assert M.get_mass() == pytest.approx(obj.mass)
    np.testing.assert_allclose(M.get_com(), 0, atol=1e-12)
    np.testing.assert_allclose(M.CalcRotationalInertia().CopyToFullMatrix3(), obj.inertia)


def test_geometry_is_the_rigid_nonconvex_surface_with_color_and_friction(tmp_path):
    obj = load_object("mug")
    _, plant, scene_graph, body = plant_with(obj, tmp_path, friction=0.6)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    (collision,) = inspector.GetGeometries(frame, Role.kProximity)
    properties = inspector.GetProximityProperties(collision)
    friction = properties.GetProperty("material", "coulomb_friction")
    assert friction.static_friction() == friction.dynamic_friction() == 0.6
    surface = inspector.maybe_get_hydroelastic_mesh(collision)
    assert surface.num_triangles() < len(obj.faces)
    vertices = np.array([surface.vertex(i) for i in range(surface.num_vertices())])
    faces = [
        [surface.element(i).vertex(k) for k in range(3)] for i in range(surface.num_triangles())
    ]
    volume = trimesh.Trimesh(vertices, faces).volume
    assert volume == pytest.approx(obj.mesh.volume, rel=0.02)  # the hull's is several times that
    assert obj.mesh.convex_hull.volume > 2 * obj.mesh.volume
    for role in (Role.kIllustration, Role.kPerception):
        (visual,) = inspector.GetGeometries(frame, role)
        rgba = inspector.GetProperties(visual, role).GetProperty("phong", "diffuse")
        assert (rgba.r(), rgba.g(), rgba.b(), rgba.a()) == pytest.approx(obj.color)


@pytest.mark.parametrize(("name", "floor"), [("bowl", 0.006), ("mug", 0.006)])
def test_a_ball_dropped_into_a_hollow_object_comes_to_rest_inside(tmp_path, name, floor):
    obj, radius = load_object(name), 0.012
    builder, plant, _, body = plant_with(obj, tmp_path)
    plant.WeldFrames(plant.world_frame(), body.body_frame(), RigidTransform(obj.p_MO))  # W = M
    ball = compliant_ball(plant, radius)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    rim = obj.extents[2]
    plant.SetFreeBodyPose(context, ball, RigidTransform([0.008, 0.0, rim + radius]))
    simulator.AdvanceTo(0.8)
    p_WB = plant.EvalBodyPoseInWorld(context, ball).translation()
    assert np.hypot(p_WB[0], p_WB[1]) < 0.03
    assert floor < p_WB[2] - radius + 0.001 < floor + 0.004  # on the hull it would rest at the rim


def test_object_falls_as_a_free_body(tmp_path):
    builder, plant, _, body = plant_with(load_object("box"), tmp_path)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    pose = plant.EvalBodyPoseInWorld(context, body)
    assert pose.translation()[2] == pytest.approx(-9.81 / 2 * 0.1**2, rel=0.03)


def test_two_objects_in_one_plant(tmp_path):
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(CONFIG, builder)
    instances = [
        add_object(plant, load_object(name), directory=tmp_path, model_name=name)
        for name in ("box", "mug")
    ]
    plant.Finalize()
    assert [plant.GetModelInstanceName(i) for i in instances] == ["box", "mug"]
