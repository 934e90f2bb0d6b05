"""``feasigrasp bench safety``: compare safety filters on the same control steps.

Two tables. Whole laws (`feasigrasp_lab.peers.safety_laws`) get a state and a twist and
return a joint velocity. Solvers (`feasigrasp_lab.bench.safety`) get the matrices of
the package's QP. The ticks come from runs of the arm under the package's own QP with twists that
change every 0.6 s, so that every tick has a solution that is safe. Half of the twists lead down at
the table or back at the base, and at half of the ticks a clearance limits the motion.
`DIR/timings.csv` has all figures, `DIR/ticks.csv` those of every tick.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import daqp
import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver, SolverOptions
from scipy import sparse
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.runs.results.arguments import add_common_arguments
from feasigrasp.runs.results.rows import Row, write_csv
from feasigrasp_lab.measures.timing import cpu_time, report_bench, timing_row
from feasigrasp_lab.peers.safety_laws import (
    Law,
    State,
    clamped_pseudo_inverse,
    drake_function,
    drake_system,
    package,
    saturation_in_the_null_space,
)

# Solvers of the safety QP beside DAQP, where they are installed.
#
# Each takes ``H, f, A, lower, upper`` of ``min 1/2 x'Hx + f'x`` with ``lower <= [x; A x] <= upper``
# and returns x, or None if it has found none. Tolerances are set so that all are about as accurate
# as an active-set method (1e-6 rad/s), as far as they have any.

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


#: Ticks, and how many in the quick run; ticks of one run, and how many lie between two taken.
TICKS, QUICK_TICKS, RUN, STRIDE = 600, 120, 360, 8
#: A twist is held for so many ticks.
HOLD = 120
#: A command that breaks a bound or a row by more than this is unsafe [rad/s or m/s].
TOLERANCE = 1e-4
#: What a command may break.
KINDS = ("limits", "acceleration", "clearance")
#: Largest of the random twists [rad/s; m/s]: what the controllers ask for at most.
LARGEST = np.array([1.5, 1.5, 1.5, 0.4, 0.4, 0.4])
HOME = np.array([0.0, -0.846, 0.0, -1.582, 0.0, 1.446, 0.0])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_safety", objects="builtin")


def ticks(n: int, seed: int, safety: SafetyFilter) -> list[State]:
    """Control ticks of runs under random twists.

    Args:
        n: How many.
        seed: Of the twists and the starts, which are uniform inside the joint limits and clear.
        safety: The QP that the arm is under.
    """
    rng = np.random.default_rng(seed)
    free, close = list[State](), list[State]()
    while len(close) < n // 2:
        q, last, V = _start(rng), np.zeros(IIWA_7.joints), np.zeros(6)
        for k in range(RUN):
            X, J = pose_and_jacobian(q)
            if k % HOLD == 0:
                V = _twist(X, rng)
            preferred = 0.5 * (HOME - q)
            matrix, vector, _ = safety.problem(q, preferred, J, V, qd_last=last)
            if k % STRIDE == STRIDE - 1:
                rows, (lower, upper, _) = matrix[IIWA_7.joints :].copy(), vector.copy()
                state = State(q, last, J, V, preferred, lower, upper, rows)
                (close if len(rows) > 0 else free).append(state)
            last = safety.velocity(q, preferred, J, V, qd_last=last)
            q = q + safety.options.period * last
    # There are more free ticks than close ones: as many, from all along the runs.
    taken = np.linspace(0, len(free) - 1, n - n // 2).astype(int)
    return [free[k] for k in taken] + close[: n // 2]


def _twist(X_WF: Array, rng: np.random.Generator) -> Array:
    """A random twist; of every four one goes straight down, and one to the axis of the base."""
    V = np.asarray(rng.uniform(-1.0, 1.0, 6) * LARGEST)
    kind = rng.integers(4)
    if kind == 0:
        V[3:] = [0.0, 0.0, -LARGEST[5]]
    elif kind == 1:
        V[3:5] = -LARGEST[3] * X_WF[:2, 3] / max(float(np.linalg.norm(X_WF[:2, 3])), 1e-3)
    return V


def _start(rng: np.random.Generator) -> Array:
    clear = Reachability(clearance=0.03, table_clearance=0.03, limit_margin=0.0)
    while True:
        q = rng.uniform(-0.95, 0.95, 7) * IIWA_7.position_limits
        if clear.admissible(q).all():
            return q


def judge(
    states: Sequence[State], commands: Sequence[Array | None], safety: SafetyFilter
) -> dict[str, Array]:
    """What the commands do at each tick; infinity or NaN without a command.

    Returns:
        By how much they break the bounds from position and velocity limits (``limits``, rad/s),
        those of the accelerations (``acceleration``, rad/s) and the rows (``clearance``, m/s);
        and how far they are from the twist, ``|W (J qd - V)|`` (``error``, m/s).
    """
    outcome = {key: np.full(len(states), np.nan) for key in (*KINDS, "error")}
    options = safety.options
    weights = _weights(options)
    change = options.acceleration_scale * options.period * IIWA_7.acceleration_limits
    for k, (s, qd) in enumerate(zip(states, commands, strict=True)):
        if qd is None or not np.isfinite(qd).all():
            continue
        lower, upper = safety.problem(s.q, np.zeros(IIWA_7.joints))[1][:2, : IIWA_7.joints]
        outcome["limits"][k] = max(0.0, (lower - qd).max(), (qd - upper).max())
        outcome["acceleration"][k] = max(0.0, (np.abs(qd - s.qd_last) - change).max())
        outcome["clearance"][k] = (s.lower[IIWA_7.joints :] - s.rows @ qd).max(initial=0.0)
        outcome["error"][k] = np.linalg.norm(weights * (s.J @ qd - s.V))
    return outcome


def rows_of(name: str, preset: str, outcome: dict[str, Array]) -> list[Row]:
    """The rows about one law or solver, all but the first over the ticks that have a command."""
    answered = np.isfinite(outcome["error"])
    n = int(answered.sum())
    silent = 100 * np.mean(~answered)
    rows = [Row.plain(f"{name}_no_answer_percent", preset, silent, "%", len(answered))]
    if n:
        for kind in KINDS:
            broken = 100 * np.mean(outcome[kind][answered] > TOLERANCE)
            rows.append(Row.plain(f"{name}_{kind}_broken_percent", preset, broken, "%", n))
        error = 1e3 * outcome["error"][answered].mean()
        rows.append(Row.plain(f"{name}_error_mm_s", preset, error, "mm/s", n))
    return rows


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps what compiled libraries print off the terminal (OSQP in Drake: a line per solve)."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def solve_law(solver: Solver, options: SafetyOptions) -> Law:
    """A law out of a solver of the QP; its matrices are made beforehand."""
    weights, damping = _weights(options), options.damping

    @cache
    def problem(s: State) -> tuple[Array, Array]:
        WJ = weights[:, None] * s.J
        H = WJ.T @ WJ + damping * np.eye(IIWA_7.joints)
        return H, -(WJ.T @ (weights * s.V)) - damping * s.qd_preferred

    return lambda s: solver(*problem(s), s.rows, s.lower, s.upper)


def _weights(options: SafetyOptions) -> Array:
    """Of the rows of a twist, angular and linear."""
    return np.array([options.rotation_weight] * 3 + [1.0] * 3)


def _all_of(law: Law, states: Sequence[State]) -> list[Array | None]:
    return [law(s) for s in states]


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    options = SafetyOptions()
    safety = SafetyFilter(options)
    states = ticks(QUICK_TICKS if args.quick else TICKS, args.seed, safety)
    laws: dict[tuple[str, str], Law] = {
        ("bench.safety", "default"): package(safety),
        ("bench.safety", "peer:saturation-in-null-space"): saturation_in_the_null_space,
        ("bench.safety", "peer:clamped-pseudo-inverse"): clamped_pseudo_inverse(),
        ("bench.safety", "peer:drake-function"): drake_function(options),
        ("bench.safety", "peer:drake-system"): drake_system(options),
    }
    for preset, solver in solvers().items():
        laws["bench.safety_qp", preset] = solve_law(solver, options)
    rows, raw = list[Row](), list[tuple[object, ...]]()
    with threadpool_limits(1):
        for (name, preset), law in tqdm(laws.items(), desc="safety"):
            with _quiet():
                commands = _all_of(law, states)
                timing = cpu_time(partial(_all_of, law, states), 0.5 if args.quick else 4.0)
            rows.append(timing_row(f"{name}_us", preset, timing, len(states)))
            outcome = judge(states, commands, safety)
            rows += rows_of(name, preset, outcome)
            figures = np.column_stack(list(outcome.values())).tolist()
            raw += [(name, preset, k, *line) for k, line in enumerate(figures)]
    write_csv(args.out / "ticks.csv", raw, ("name", "preset", "tick", *KINDS, "error"))
    report_bench(args, "safety", rows)
    return 0
