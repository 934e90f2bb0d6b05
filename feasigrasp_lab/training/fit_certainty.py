"""``feasigrasp fit certainty``: calibrate the success probability of grasps.

Household shapes that no training and no evaluation uses, half of them of the families that no
training uses, are seen from one to three sides. What field and network say of grasp candidates is
set against the verdicts of the true meshes; the logistic coefficients that explain these best are
those of `feasigrasp.models.grasps.success_probability`.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

from feasigrasp.errors import GraspError, PointCloudError
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.grasps import success_probability
from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.filter import COSINE_STEPS, contact_state
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.hand_clearance import (
    HOPEFUL,
    MARGIN,
    THIN_WALL,
    hand_clearance,
    observed_clearance,
)
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.shape.gpdf import INVENTED, MARGIN_GROWTH, Gpdf
from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.results.workers import in_processes, made_with
from feasigrasp_lab.training.data.grasp_examples import fuse_and_complete
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import HELD_OUT, TRAINED, make_shape
from feasigrasp_lab.training.data.views import ViewedObject, turning_views

#: Evidence (n, k) and verdicts (n,) by the name of the coefficients.
Cases = dict[str, tuple[Array, Mask]]

#: Seeds of shapes from here on are used by nothing else. Source: definition.
FIRST_SEED = 20_000_000
#: The coefficients, in the order in which they build on each other.
NAMES = (
    *("CONTACT", "JOINT_CONTACT", "THIN_CONTACT"),
    *("CLEARANCE", "JOINT_CLEARANCE", "UNOBSERVED_CLEARANCE"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/fit_certainty")
    parser.add_argument("--objects", type=positive, default=240, help="Number of household shapes.")


def shape_names(count: int, seed: int) -> list[tuple[str, int]]:
    """Families and seeds of the shapes, every other one of a family that is held out."""
    turns = (HELD_OUT, TRAINED)
    return [
        (turns[i % 2][(i // 2) % len(turns[i % 2])], FIRST_SEED + 100_000 * seed + i)
        for i in range(count)
    ]


def object_cases(family: str, number: int) -> Cases:
    """What field and network say of grasps of one shape, and what is true."""
    obj = make_shape(family, number)
    viewed, truth, rng = ViewedObject(obj), TrueGrasps(obj.mesh), np.random.default_rng(number)
    # How often an object is seen from one, two and three sides.
    cameras = turning_views(rng, viewed.center, int(rng.choice((1, 1, 1, 2, 3))))
    try:
        field = fuse_and_complete([viewed.view(X_OC, rng) for X_OC in cameras])
    except PointCloudError:  # it can hardly be seen from there
        return {}
    network, opposed = NetworkSampler(), AntipodalSampler()
    gripper = network.gripper
    cases: Cases = {}

    X_OG, width, _ = opposed.candidates(field)
    pairs = _opposing(field, GraspSet(X_OG, width, np.ones(len(width))))
    evidence = np.column_stack(success_probability.contact_evidence(field, pairs))
    cases["CONTACT"] = evidence, truth.truly_antipodal(pairs.X_OG, gripper.max_opening)

    X_OG, width, learned = network.candidates(field)
    proposed = GraspSet(X_OG, width, learned[:, 0])
    pairs = _opposing(field, proposed)
    contact = success_probability.contact_evidence(field, pairs)
    evidence = np.column_stack([success_probability.odds(pairs.score), *contact])
    cases["JOINT_CONTACT"] = evidence, truth.truly_antipodal(pairs.X_OG, gripper.max_opening)
    thin = proposed.select(width < THIN_WALL)
    deviations = success_probability.contact_evidence(field, thin)[1]
    evidence = np.column_stack([success_probability.odds(thin.score), deviations])
    cases["THIN_CONTACT"] = evidence, truth.truly_antipodal(thin.X_OG, gripper.max_opening)

    clearance, deviation = hand_clearance(field, X_OG, gripper)
    free = clearance >= MARGIN + MARGIN_GROWTH * deviation
    verdict = truth.hand_free(X_OG, gripper)
    evidence = np.column_stack(
        [
            success_probability.odds(learned[:, 1]),
            success_probability.clearance_evidence(clearance, deviation),
        ]
    )
    cases["CLEARANCE"] = evidence[free, 1:], verdict[free]
    cases["JOINT_CLEARANCE"] = evidence[free], verdict[free]
    if field.has_free_space:
        in_doubt = np.flatnonzero(~free & (learned.prod(axis=1) >= HOPEFUL))
        seen = observed_clearance(field, X_OG[in_doubt], gripper, INVENTED)
        in_doubt = in_doubt[seen >= MARGIN]
        cases["UNOBSERVED_CLEARANCE"] = evidence[in_doubt, :1], verdict[in_doubt]
    return cases


def _opposing(field: Gpdf, grasps: GraspSet) -> GraspSet:
    """The grasps whose contacts oppose each other on the field, by its own estimate."""
    known = np.flatnonzero(grasps.width >= THIN_WALL)
    _, cosine = contact_state(field, grasps.select(known))
    return grasps.select(known[cosine <= max(COSINE_STEPS)])


def fit(evidence: Array, verdict: Mask) -> tuple[tuple[float, ...], float]:
    """The coefficients with the least mean negative log likelihood, and that."""
    design = np.column_stack([np.ones(len(evidence)), evidence])
    scale = np.maximum(np.abs(design).mean(axis=0), 1e-9)
    sign = np.where(verdict, 1.0, -1.0)

    def loss(x: Array) -> float:
        return float(np.logaddexp(0.0, -sign * (design @ (x / scale))).mean())

    found = minimize(loss, np.zeros(design.shape[1]))
    return tuple(float(c) for c in found.x / scale), float(found.fun)


def stages(cases: Cases) -> Iterator[tuple[str, tuple[float, ...], float, int]]:
    """Name, coefficients, loss and number of cases of every stage, each fitted on the last.

    Raises:
        GraspError: A stage has no cases.
    """
    found: dict[str, tuple[float, ...]] = {}
    for name in NAMES:
        evidence, verdict = cases[name]
        if len(verdict) == 0:
            raise GraspError(f"no grasp of these shapes is a case of {name}; give more --objects")
        if name.startswith("JOINT_"):  # of the network's odds, and of what the field's stage says
            of_field = success_probability.probability(
                found[name.removeprefix("JOINT_")], *evidence[:, 1:].T
            )
            evidence = np.column_stack([evidence[:, 0], success_probability.odds(of_field)])
        found[name], loss = fit(evidence, verdict)
        yield name, found[name], loss, len(verdict)


def main(args: argparse.Namespace) -> int:
    """Fits and prints the coefficients, and writes ``certainty.json``."""
    shapes = shape_names(args.objects, args.seed)
    made = in_processes(object_cases, shapes, args.jobs, ordered=True)
    all_cases = [c for c in tqdm(made, total=len(shapes), desc="objects") if c]
    cases: Cases = {}
    for name in NAMES:
        parts = zip(*(c[name] for c in all_cases if name in c), strict=True)
        evidence, verdict = (np.concatenate(part) for part in parts)
        cases[name] = evidence, verdict
    written = {}
    for name, coefficients, loss, count in stages(cases):
        rounded = tuple(round(c, 3) for c in coefficients)
        print(f"{name} = {rounded}  (log loss {loss:.4f}, {count} grasps)")
        written[name] = {"coefficients": coefficients, "log_loss": loss, "n": count}
    about = made_with() | {"seed": args.seed, "objects": args.objects}
    write_json(written | about, args.out / "certainty.json")
    return 0
