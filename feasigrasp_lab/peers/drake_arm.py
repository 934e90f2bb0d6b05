"""The arm in Drake: URDF in a plant, and capsules of the hand in a collision checker."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Capsule
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import JacobianWrtVariable, SpatialInertia
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.robot.capsules import hand_capsules
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path


class DrakeArm:
    """Kinematics by `MultibodyPlant`, verdicts by `SceneGraphCollisionChecker`.

    The links' capsules and the pairs to check come with the URDF. The hand's capsules are put on a
    body that is welded to link 7 and checked against links 0 to 2. (Its camera against link 2 is no
    pair of our model: inside the joint limits they stay 3 cm apart.)

    Attributes:
        checker: The collision checker, with plant and scene graph.
    """

    def __init__(self) -> None:
        """The arm with its hand, by itself."""
        builder = RobotDiagramBuilder(time_step=0.001)
        builder.parser().package_map().Add("feasigrasp", str(model_path()))
        (arm,) = builder.parser().AddModels(str(model_path("iiwa", "iiwa7.urdf")))
        plant = builder.plant()
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(IIWA_7.link_names[0]))
        # A body of its own, since the checker filters by bodies.
        hand = plant.AddRigidBody("hand", arm, SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.WeldFrames(plant.GetFrameByName(IIWA_7.link_names[-1]), hand.body_frame())
        for k, capsule in enumerate(hand_capsules()):
            a, b = np.array(capsule.a), np.array(capsule.b)
            plant.RegisterCollisionGeometry(
                hand,
                RigidTransform(RotationMatrix.MakeFromOneVector(b - a, 2), (a + b) / 2),
                Capsule(capsule.radius, float(np.linalg.norm(b - a))),
                f"hand_{k}",
                CoulombFriction(),
            )
        plant.Finalize()
        self.checker = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=[arm], edge_step_size=0.1
        )
        for link in IIWA_7.link_names[3:]:
            self.checker.SetCollisionFilteredBetween(plant.GetBodyByName(link), hand, True)
        self._plant = self.checker.plant()
        self._flange = self._plant.GetFrameByName("iiwa_flange")
        self._context = self._plant.CreateDefaultContext()

    def pose_and_jacobian(self, Q: ArrayLike) -> tuple[Array, Array]:
        """Flange poses (n, 4, 4) and Jacobians (n, 6, 7) of configurations (n, 7), one by one."""
        Q = np.asarray(Q, dtype=float)
        X_WF, J_WF = np.empty((len(Q), 4, 4)), np.empty((len(Q), 6, IIWA_7.joints))
        plant, context, flange, world = (
            self._plant, self._context, self._flange, self._plant.world_frame()
        )  # fmt: skip
        origin = np.zeros(3)
        for k, q in enumerate(Q):
            plant.SetPositions(context, q)
            J_WF[k] = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, flange, origin, world, world
            )
            X_WF[k] = flange.CalcPoseInWorld(context).GetAsMatrix4()
        return X_WF, J_WF

    def in_collision(self, Q: ArrayLike) -> Mask:
        """Whether the checker finds configurations (n, 7) in self-collision, shape (n,).

        It looks for a signed distance that is not positive, and computes distances iteratively:
        about one in a thousand shallow penetrations gets a distance just above zero and is missed.
        """
        free = self.checker.CheckConfigsCollisionFree(
            list(np.asarray(Q, dtype=float)), parallelize=False
        )
        return np.asarray(free) == 0

    def has_collisions(self, Q: ArrayLike) -> Mask:
        """The same from `QueryObject.HasCollisions`, a yes-or-no test of every pair."""
        hit = np.empty(len(np.asarray(Q)), dtype=bool)
        for k, q in enumerate(np.asarray(Q, dtype=float)):
            self.checker.UpdatePositions(q)
            hit[k] = self.checker.model_context().GetQueryObject().HasCollisions()
        return hit
