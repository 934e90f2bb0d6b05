"""Every cause from samples in which it, and nothing else, kept the object from being held."""

import numpy as np
import pytest

from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.runs.metrics.cause import PUSHED_AWAY, Cause, cause_of
from feasigrasp.runs.metrics.handling import ObjectTruth

A, C, L, S, H, D = (int(phase) for phase in Phase)
WHOLE = [A, A, C, C, L, S, H, D]
APPROACH = [A] * 8


def course(phase=WHOLE, *, pushed=0.0, touched=True, broke_off=False, slip=(0.02, 0.0), **columns):
    """A run that went to its end, the object 2 cm off in the hand, but for what is given."""
    n = len(phase)
    usual = {"phase": phase, "sampled_grasps": 60.0, "reachable_grasps": 20.0, "view_age": 0.3}
    samples = {k: np.broadcast_to(v, n).astype(float) for k, v in (usual | columns).items()}
    truth = ObjectTruth(np.tile(np.eye(4), (n, 1, 1)), np.zeros(4), np.inf, touched, broke_off)
    return samples, truth, pushed, slip


NONE_LATER = {"sampled_grasps": 0.0, "reachable_grasps": 0.0}


@pytest.mark.parametrize(
    ("run", "cause"),
    [
        (course(broke_off=True), Cause.BROKE_OFF),
        (course(APPROACH, broke_off=True, view_age=np.nan, **NONE_LATER), Cause.BROKE_OFF),
        (course(APPROACH, view_age=np.nan, **NONE_LATER), Cause.NOTHING_SEEN),
        (course(APPROACH, **NONE_LATER), Cause.NO_GRASP),
        (course(APPROACH, reachable_grasps=0.0), Cause.NONE_REACHABLE),
        # Seen late, sampled late, reachable for a moment: that is enough not to blame them.
        (course(APPROACH, view_age=[np.nan] * 7 + [0.0], **NONE_LATER), Cause.NO_GRASP),
        (course(APPROACH, sampled_grasps=[0] * 7 + [1], reachable_grasps=0), Cause.NONE_REACHABLE),
        (course(APPROACH, reachable_grasps=[0, 0, 1, 0, 0, 0, 0, 0]), Cause.NEVER_SETTLED),
        (course(APPROACH), Cause.NEVER_SETTLED),
        (course(APPROACH, pushed=0.99 * PUSHED_AWAY), Cause.NEVER_SETTLED),
        (course(APPROACH, pushed=1.01 * PUSHED_AWAY), Cause.PUSHED_AWAY),
        (course([A, C, C, A, A, A, A, A], pushed=1.01 * PUSHED_AWAY), Cause.PUSHED_AWAY),
        (course([A, C, C, A, A, A, A, A]), Cause.MISSED),
        (course([A, C, C, A, A, A, C, C]), Cause.MISSED),
        (course([A, A, A, A, A, A, C, C]), Cause.OUT_OF_TIME),
        (course([A, A, A, A, A, A, C, C], touched=False), Cause.OUT_OF_TIME),
        (course([A, A, A, C, C, L, L, S]), Cause.OUT_OF_TIME),
        (course([A, A, A, C, C, L, L, S], touched=False), Cause.DROPPED),
        (course(touched=False), Cause.DROPPED),
        (course(slip=(0.0, 0.3)), Cause.SLIPPED),
        (course(slip=(0.009, 0.2)), Cause.NOT_LIFTED),
        (course(), Cause.SLIPPED),
        # Pushed or missed at first, grasped in the end: what came last counts.
        (course(pushed=1.01 * PUSHED_AWAY), Cause.SLIPPED),
        (course([A, C, A, C, L, S, H, D], touched=False), Cause.DROPPED),
    ],
)
def test_each_rule(run, cause):
    assert cause_of(*run) is cause


def test_every_cause_has_a_run_above_and_a_line_in_the_docs(repository):
    marks = test_each_rule.pytestmark[0].args[1]
    assert {cause for _, cause in marks} == set(Cause)
    text = (repository / "docs" / "results_schema.md").read_text().split("### `cause`")[-1]
    places = [text.index(f"\n| `{cause}` |") for cause in Cause]
    assert places == sorted(places)


@pytest.mark.parametrize(
    ("run", "cause"),
    [
        (course(APPROACH, broke_off=True), Cause.BROKE_OFF),
        (course(APPROACH), Cause.NEVER_SETTLED),
        (course([A, C, C, A, A, A, A, A]), Cause.MISSED),
        (course(), Cause.SLIPPED),
    ],
)
def test_where_nobody_knows_of_grasps_none_is_blamed(run, cause):
    """Behind the drivers' messages, where the controller is another process."""
    nobody = dict.fromkeys(("sampled_grasps", "reachable_grasps", "view_age"), np.full(8, np.nan))
    samples, truth, _, slip = run
    assert cause_of(samples | nobody, truth, slip=slip) is cause


def test_without_the_truth_the_samples_decide():
    assert cause_of(course(APPROACH)[0]) is Cause.NEVER_SETTLED
    assert cause_of(course()[0]) is Cause.DROPPED
