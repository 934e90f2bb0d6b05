"""Knots of plans for tests of what is summed over them."""

import numpy as np

from feasigrasp.models.control.horizon.knots import Form, Knots, Neighbours
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian


def knots_at(Q, X_FG, X_WO, *, times=None, X_WO_after=None, share=1.0, hand=None):
    """Knots with positions (N, 7) and poses of the object (N, 4, 4); the hand's as given if any.

    ``hand`` are its poses and Jacobians, those of the arm by default.
    """
    n = len(Q)
    X_WH, J_WH = hand or zip(*(pose_and_jacobian(q, X_FG) for q in Q), strict=True)
    return Knots(
        IIWA_7.chain,
        np.zeros(n) if times is None else np.array(times, dtype=float),
        np.array(Q, dtype=float),
        np.array(X_WH),
        np.array(J_WH),
        np.array(X_WO),
        np.array(X_WO if X_WO_after is None else X_WO_after),
        np.full(n, float(share)),
    )


def neighbours(X_OG, penalty=None, branch=None, psi=None):
    """Grasps (m, 4, 4) that cost nothing more than the first, in branch 0, unless given."""
    m = len(X_OG)
    return Neighbours(
        np.array(X_OG),
        np.zeros(m, dtype=np.int64) if branch is None else np.array(branch, dtype=np.int64),
        np.zeros(m) if psi is None else np.array(psi, dtype=float),
        np.zeros(m) if penalty is None else np.array(penalty, dtype=float),
    )


def empty_form(n=1, value=0.0):
    """Quadratic forms at n knots, all entries alike."""
    return Form(np.full((n, 7, 7), value), np.full((n, 7), value), np.zeros((n, 7)))
