"""Solvers of the safety QP beside DAQP, where they are installed.

Each takes ``H, f, A, lower, upper`` of ``min 1/2 x'Hx + f'x`` with ``lower <= [x; A x] <= upper``
and returns x, or None if it has found none. Tolerances are set so that all are about as accurate as
an active-set method (1e-6 rad/s), as far as they have any.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import daqp
import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver, SolverOptions
from scipy import sparse

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7

Solver = Callable[[Array, Array, Array, Array, Array], "Array | None"]

_TOLERANCE = 1e-7
_N = IIWA_7.joints


def solve_daqp(H: Array, f: Array, A: Array, lower: Array, upper: Array) -> Array | None:
    """Dual active set with recursive LDL' updates; what the package uses."""
    x, _, status, _ = daqp.solve(H, f, A, upper, lower)
    return x if status > 0 else None


def _stacked(A: Array) -> Array:
    return np.vstack([np.eye(_N), A])


def _quadprog(quadprog, H, f, A, lower, upper):
    C = np.vstack([np.eye(_N), -np.eye(_N), A])
    b = np.concatenate([lower[:_N], -upper[:_N], lower[_N:]])
    try:
        return quadprog.solve_qp(H, -f, C.T, b)[0]
    except ValueError:  # inconsistent constraints
        return None


def _proxqp(proxsuite, H, f, A, lower, upper):
    bounds, precision = (_stacked(A), lower, upper), {"eps_abs": _TOLERANCE, "eps_rel": 0.0}
    result = proxsuite.proxqp.dense.solve(H, f, None, None, *bounds, **precision)
    solved = result.info.status == proxsuite.proxqp.PROXQP_SOLVED
    return result.x if solved else None


def _piqp(piqp, H, f, A, lower, upper):
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = _TOLERANCE
    solver.setup(H, f, None, None, A, lower[_N:], upper[_N:], lower[:_N], upper[:_N])
    return solver.result.x if solver.solve() == piqp.PIQP_SOLVED else None


def _osqp(osqp, H, f, A, lower, upper):
    solver = osqp.OSQP()
    P, G = sparse.triu(H, format="csc"), sparse.csc_matrix(_stacked(A))
    precision = {"eps_abs": _TOLERANCE, "eps_rel": 0.0, "max_iter": 20000}
    solver.setup(P, f, G, lower, upper, verbose=False, **precision)
    result = solver.solve(raise_error=False)
    return result.x if result.info.status_val == 1 else None


def _clarabel(clarabel, H, f, A, lower, upper):
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    G = sparse.csc_matrix(np.vstack([np.eye(_N), -np.eye(_N), -A]))
    h = np.concatenate([upper[:_N], -lower[:_N], -lower[_N:]])
    cones = [clarabel.NonnegativeConeT(len(h))]
    solver = clarabel.DefaultSolver(sparse.triu(H, format="csc"), f, G, h, cones, settings)
    solution = solver.solve()
    return np.array(solution.x) if str(solution.status) == "Solved" else None


def _drake(solver: Any, options: dict[str, float]) -> Solver:
    """Drake's MathematicalProgram with one of its solvers."""
    settings = SolverOptions()
    for name, value in options.items():
        settings.SetOption(solver.solver_id(), name, value)

    def solve(H, f, A, lower, upper):
        program = MathematicalProgram()
        x = program.NewContinuousVariables(_N)
        program.AddQuadraticCost(H, f, x, is_convex=True)
        program.AddBoundingBoxConstraint(lower[:_N], upper[:_N], x)
        if len(A) > 0:
            program.AddLinearConstraint(A, lower[_N:], np.full(len(A), np.inf), x)
        result = solver.Solve(program, None, settings)
        return result.GetSolution(x) if result.is_success() else None

    return solve


#: Every peer that may be installed: its name on PyPI, and how it solves, given its module.
_INSTALLABLE: dict[str, Callable[..., Array | None]] = {
    "quadprog": _quadprog,
    "proxsuite": _proxqp,
    "piqp": _piqp,
    "osqp": _osqp,
    "clarabel": _clarabel,
}


def solvers() -> dict[str, Solver]:
    """All that can run here by preset, DAQP as ``default``; prints which are left out."""
    found: dict[str, Solver] = {"default": solve_daqp}
    for name, solve in _INSTALLABLE.items():
        if find_spec(name):
            found[f"peer:{name}"] = partial(solve, import_module(name))
        else:
            print(f"{name} is not installed (PyPI: {name}): its rows are left out")
    found["peer:drake-osqp"] = _drake(
        OsqpSolver(), {"eps_abs": _TOLERANCE, "eps_rel": 0.0, "max_iter": 20000}
    )
    found["peer:drake-clarabel"] = _drake(ClarabelSolver(), {})
    return found
