"""Peers for comparison: the paper's control steps as plain array code, and the arm in Drake.

Each control step is written once, vectorised over components, grasps and joints, for NumPy and for
torch: ``xp`` is either module. None of our kernels is used, so that the results check ours as well.
"""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Capsule
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction
from pydrake.multibody.tree import JacobianWrtVariable, SpatialInertia
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry.se3 import hat
from feasigrasp.models.robot.capsules import hand_capsules
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import model_path
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.paper.task_law import GAINS

#: An array of NumPy or a tensor of torch.
AnyArray = Any


class ArrayArm:
    """Kinematics of the iiwa with a hand, batches lead."""

    def __init__(self, xp: ModuleType, X_FG: ArrayLike) -> None:
        """The arm whose flange carries the hand at ``X_FG``, shape (4, 4)."""
        self.xp = xp
        axes = np.array([hat(axis) for axis in IIWA_7.axes])
        self._axis, self._hat = xp.asarray(np.array(IIWA_7.axes)), xp.asarray(axes)
        self._hat_squared, self._eye = xp.asarray(axes @ axes), xp.asarray(np.eye(3))
        self._rise = xp.asarray(np.outer(IIWA_7.link_steps, [0.0, 0.0, 1.0]))
        self._R_FG = xp.asarray(np.asarray(X_FG)[:3, :3].copy())
        self._p_FG = xp.asarray(np.asarray(X_FG)[:3, 3].copy())

    def hand(self, q: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Orientation (n, 3, 3), position (n, 3) and Jacobian (n, 6, 7) of the hand at q (n, 7)."""
        xp = self.xp
        sin, cos = xp.sin(q)[..., None, None], xp.cos(q)[..., None, None]
        turns = self._eye + sin * self._hat + (1.0 - cos) * self._hat_squared
        R, p = self._eye, self._rise[0]
        axes, origins = [], []
        for i in range(IIWA_7.joints):
            axes.append(R @ self._axis[i] + 0.0 * q[:, :3])
            origins.append(p + 0.0 * q[:, :3])
            R = R @ turns[:, i]
            p = p + R @ self._rise[i + 1]
        p = p + R @ self._p_FG
        axis, origin = xp.stack(axes, -1), xp.stack(origins, -1)
        lever = p[:, :, None] - origin
        linear = xp.stack(
            [
                axis[:, 1] * lever[:, 2] - axis[:, 2] * lever[:, 1],
                axis[:, 2] * lever[:, 0] - axis[:, 0] * lever[:, 2],
                axis[:, 0] * lever[:, 1] - axis[:, 1] * lever[:, 0],
            ],
            1,
        )
        return R @ self._R_FG, p, xp.concatenate([axis, linear], 1)


def se3_log(xp: ModuleType, R: AnyArray, p: AnyArray) -> AnyArray:
    """Tangent vectors [angular; linear] (n, 6) of poses (n, 3, 3), (n, 3); not at half a turn."""
    trace = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    angle = xp.arccos(xp.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    safe = xp.where(angle < 1e-6, 1e-6 + 0.0 * angle, angle)
    factor = xp.where(angle < 1e-6, 0.5 + 0.0 * angle, 0.5 * safe / xp.sin(safe))
    w = factor[:, None] * xp.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], 1
    )
    b = xp.where(
        angle < 1e-6,
        1.0 / 12.0 + 0.0 * angle,
        1.0 / safe**2 - (1.0 + xp.cos(safe)) / (2.0 * safe * xp.sin(safe)),
    )
    wp = _cross(xp, w, p)
    return xp.concatenate([w, p - 0.5 * wp + b[:, None] * _cross(xp, w, wp)], 1)


def _cross(xp: ModuleType, a: AnyArray, b: AnyArray) -> AnyArray:
    return xp.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        1,
    )


class ArrayTaskStep:
    """The paper's step in task space: mixture, preconditioned direction, damped pseudo-inverse."""

    def __init__(self, xp: ModuleType, mixture: RiemannianMixture, X_FG: ArrayLike) -> None:
        """A step over one mixture in the object frame."""
        self.xp, self._arm = xp, ArrayArm(xp, X_FG)
        means = mixture.means
        self._R_GO = xp.asarray(np.swapaxes(means[:, :3, :3], 1, 2).copy())
        self._p_OG = xp.asarray(means[:, :3, 3].copy())
        self._precision = xp.asarray(np.linalg.inv(mixture.covariances))
        log_det = np.linalg.slogdet(mixture.covariances)[1]
        self._log_weight = xp.asarray(np.log(mixture.weights) - 0.5 * log_det)

    def __call__(self, q: AnyArray, X_WO: AnyArray, V_WO: AnyArray) -> AnyArray:
        """Joint velocity (7,) [rad/s] at q (7,), object pose (4, 4) and twist (6,)."""
        xp = self.xp
        q, X_WO, V_WO = xp.asarray(q), xp.asarray(X_WO), xp.asarray(V_WO)
        R_WH, p_WH, J = (x[0] for x in self._arm.hand(q[None]))
        R_OW, p_WO = X_WO[:3, :3].T, X_WO[:3, 3]
        R_OH, p_OH = R_OW @ R_WH, R_OW @ (p_WH - p_WO)
        offset = (self._R_GO @ (p_OH - self._p_OG)[:, :, None])[:, :, 0]
        xi = se3_log(xp, self._R_GO @ R_OH, offset)
        whitened = (self._precision @ xi[:, :, None])[:, :, 0]
        log_density = self._log_weight - 0.5 * xp.sum(xi * whitened, -1)
        r = xp.exp(log_density - xp.max(log_density))
        u = -GAINS[0] * (r @ xi) / xp.sum(r)
        carried = V_WO[3:] + _cross(xp, V_WO[None, :3], (p_WH - p_WO)[None])[0]
        V = xp.concatenate([R_WH @ u[:3] + V_WO[:3], R_WH @ u[3:] + carried])
        square = PaperOptions.damping**2 * xp.eye(6, dtype=J.dtype)
        return J.T @ xp.linalg.solve(J @ J.T + square, V)


class ArrayJointStep:
    """The paper's step in joint space: IK of every grasp, Gaussian process, gradient.

    Where the paper draws solutions from a network and refines them, these are found by damped
    least squares from the present configuration, all grasps at once.
    """

    def __init__(
        self, xp: ModuleType, X_OG: ArrayLike, X_FG: ArrayLike, *, iterations: int = 10
    ) -> None:
        """A step over grasps in the object frame, shape (n, 4, 4)."""
        self.xp, self._arm, self._iterations = xp, ArrayArm(xp, X_FG), iterations
        # Of least squares, and of the Gaussian process.
        damping, noise_variance = 0.05, 1e-6
        grasps = np.asarray(X_OG)
        self._R_OG = xp.asarray(grasps[:, :3, :3].copy())
        self._p_OG = xp.asarray(grasps[:, :3, 3].copy())
        self._ridge = xp.asarray(damping**2 * np.eye(6))
        self._noise = xp.asarray(noise_variance * np.eye(len(grasps)))
        self._ones = xp.asarray(np.ones(len(grasps)))

    def solve(self, q: AnyArray, X_WO: AnyArray) -> AnyArray:
        """Configurations of the grasps (n, 7), from q (7,)."""
        xp = self.xp
        R_WG, p_WG = X_WO[:3, :3] @ self._R_OG, self._p_OG @ X_WO[:3, :3].T + X_WO[:3, 3]
        found = q + 0.0 * self._ones[:, None]
        for _ in range(self._iterations):
            R, p, J = self._arm.hand(found)
            R_HW = xp.swapaxes(R, 1, 2)
            body = se3_log(xp, R_HW @ R_WG, (R_HW @ (p_WG - p)[:, :, None])[:, :, 0])
            twist = xp.concatenate(
                [(R @ part[:, :, None])[:, :, 0] for part in (body[:, :3], body[:, 3:])], 1
            )
            J_T = xp.swapaxes(J, 1, 2)
            y = xp.linalg.solve(J @ J_T + self._ridge, twist[:, :, None])
            found = found + (J_T @ y)[:, :, 0]
        return found

    def __call__(self, q: AnyArray, X_WO: AnyArray) -> AnyArray:
        """Joint velocity (7,) [rad/s] at q (7,) and object pose (4, 4)."""
        # Of the field [rad], and of the velocity [1/s].
        length_scale, gain = 0.1, 5.0
        xp = self.xp
        q, X_WO = xp.asarray(q), xp.asarray(X_WO)
        nodes = self.solve(q, X_WO)
        gaps = nodes[:, None] - nodes
        K = xp.exp(-xp.sqrt(xp.sum(gaps**2, -1)) / length_scale)
        alpha = xp.linalg.solve(K + self._noise, self._ones)
        offset = q - nodes
        distance = xp.sqrt(xp.sum(offset**2, -1))
        nearest = distance.min()
        terms = alpha * xp.exp((nearest - distance) / length_scale)
        o = xp.sum(terms)
        d = nearest - length_scale * xp.log(xp.clip(o, 1e-30, None))
        gradient = (terms / xp.clip(distance, 1e-9, None)) @ offset / o
        return -gain * d * gradient / xp.sqrt(xp.sum(gradient**2))


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
