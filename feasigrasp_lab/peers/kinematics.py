"""The iiwa in other libraries for its kinematics, where they are installed."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7


def pinocchio_kinematics() -> Callable[[Array], tuple[Array, Array]]:
    """Flange poses and Jacobians (rows [linear; angular]) of configurations (n, 7), one by one.

    Raises:
        ImportError: pinocchio (PyPI: pin) is not installed.
    """
    pin = import_module("pinocchio")
    model, joint = pin.Model(), 0
    *steps, last = (pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in IIWA_7.link_steps)
    for name, step, axis in zip(IIWA_7.joint_names, steps, IIWA_7.joint_axes, strict=True):
        kind = pin.JointModelRZ() if axis[2] else pin.JointModelRevoluteUnaligned(axis)
        joint = model.addJoint(joint, kind, step, name)
    flange = model.addFrame(pin.Frame("flange", joint, 0, last, pin.FrameType.OP_FRAME))
    data = model.createData()

    def run(Q: Array) -> tuple[Array, Array]:
        X_WF, J_WF = np.empty((len(Q), 4, 4)), np.empty((len(Q), 6, IIWA_7.joints))
        for k, q in enumerate(Q):
            J_WF[k] = pin.computeFrameJacobian(model, data, q, flange, pin.LOCAL_WORLD_ALIGNED)
            X_WF[k] = pin.updateFramePlacement(model, data, flange).homogeneous
        return X_WF, J_WF

    return run


def eaik_nearest(values: Array) -> Callable[[Array, Array], Array]:
    """Nearest configurations inside the limits, by closed-form inverse kinematics of EAIK.

    EAIK solves arms of six joints: joint 3 is fixed at each of ``values``, where ours fixes the arm
    angle. From flange poses (n, 4, 4) and the present configuration (7,) to configurations (n, 7),
    NaN where there is none.

    Raises:
        ImportError: EAIK (PyPI: eaik) is not installed.
    """
    homogeneous = import_module("eaik.IK_Homogeneous")
    frames = np.tile(np.eye(4), (IIWA_7.joints + 1, 1, 1))
    frames[:, 2, 3] = np.cumsum(IIWA_7.link_steps)
    for frame, axis in zip(frames, IIWA_7.joint_axes, strict=False):
        if axis[1]:  # z-axis along +-y
            frame[:3, :3] = np.array([[1, 0, 0], [0, 0, axis[1]], [0, -axis[1], 0]])
    robots = [homogeneous.HomogeneousRobot(frames, fixed_axes=[(2, float(v))]) for v in values]

    def run(X_WF: Array, q: Array) -> Array:
        best = np.full((len(X_WF), IIWA_7.joints), np.nan)
        for k, X in enumerate(X_WF):
            solutions = [robot.IK(X) for robot in robots]
            exact = [np.asarray(s.Q)[~np.asarray(s.is_LS)] for s in solutions if len(s.Q)]
            found = np.concatenate([np.empty((0, IIWA_7.joints)), *exact])
            found = found[(np.abs(found) <= IIWA_7.position_limits).all(axis=1)]
            if len(found):
                times = (np.abs(found - q) / IIWA_7.velocity_limits).max(axis=1)
                best[k] = found[np.argmin(times)]
        return best

    return run
