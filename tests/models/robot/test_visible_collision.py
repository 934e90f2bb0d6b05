"""The capsules against geometry that knows nothing of them: the hulls of the visible links."""

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Convex, Role
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path
from feasigrasp_lab import arm as sc

LINKS = range(8)


class VisibleArm:
    """The arm in a plant, with the hull of every visible link beside its capsules."""

    def __init__(self, folder):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
        parser = Parser(self.plant)
        parser.package_map().Add("feasigrasp", str(model_path()))
        parser.AddModels(str(model_path("iiwa", "iiwa7.urdf")))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("iiwa_link_0"))
        for link in LINKS:
            scene = trimesh.load(model_path("iiwa", "meshes", f"link_{link}.gltf"), process=False)
            points = scene.to_mesh().vertices[:, [0, 2, 1]] * [1, -1, 1]  # glTF is y up
            file = folder / f"link_{link}.obj"
            trimesh.convex.convex_hull(points).export(file)
            body = self.plant.GetBodyByName(f"iiwa_link_{link}")
            self.plant.RegisterCollisionGeometry(
                body, RigidTransform(), Convex(str(file)), f"hull_{link}", CoulombFriction()
            )
        self.plant.Finalize()
        inspector = self.scene_graph.model_inspector()
        self.hull = {}
        for geometry in inspector.GetAllGeometryIds(Role.kProximity):
            name = inspector.GetName(geometry).split("::")[-1]
            if name.startswith("hull_"):
                self.hull[int(name.removeprefix("hull_"))] = geometry
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()

    def touching(self, q):
        """Pairs of links that are no neighbours and whose hulls meet.

        Links 5 and 7 do not count: both turn about the wrist, and the hull of the curved link 5
        fills the room that it leaves for link 7.
        """
        self.plant.SetPositions(self.plant.GetMyContextFromRoot(self.context), q)
        context = self.scene_graph.GetMyContextFromRoot(self.context)
        query = self.scene_graph.get_query_output_port().Eval(context)
        link = {geometry: number for number, geometry in self.hull.items()}
        met = (
            {link.get(hit.id_A), link.get(hit.id_B)} for hit in query.ComputePointPairPenetration()
        )
        return [p for p in met if None not in p and max(p) - min(p) > 1 and p != {5, 7}]


@pytest.fixture(scope="module")
def visible(tmp_path_factory):
    return VisibleArm(tmp_path_factory.mktemp("hulls"))


def folded_configurations(n, seed):
    """Postures back towards the base, where links meet; other than those of the other tests."""
    rng = np.random.default_rng(seed)
    q = IIWA_7.random_positions(rng, n)
    q[:, [2, 4]] *= 0.3
    signs = np.sign(q[:, :1]) * (1, -1, 1)
    q[:, [1, 3, 5]] = signs * IIWA_7.upper[[1, 3, 5]] * rng.uniform(0.6, 1.0, (n, 3))
    return q


def test_visible_links_never_meet_where_the_clearance_is_kept(visible):
    """Capsules are not quite around the links; what they lack, the clearance of control has."""
    model, clearance = capsule_model(with_hand=False), SafetyOptions().clearance
    Q = folded_configurations(1500, seed=12)
    kept = ~sc.in_collision(Q, model, clearance)
    meet = np.array([bool(visible.touching(q)) for q in Q])
    assert min(meet.sum(), kept.sum()) > 100
    assert not (meet & kept).any()
