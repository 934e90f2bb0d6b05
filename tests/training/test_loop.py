"""What all trainings share: the schedule and the order of the examples."""

import math

import numpy as np
import pytest

from feasigrasp.training.loop import learning_rate, rows_of_step


@pytest.mark.parametrize("least", [1e-2, 1e-3])
def test_the_learning_rate_rises_and_falls(least):
    def rate(step, turn):
        return learning_rate(1.0, step, turn, warm_up=100, least=least)

    assert rate(0, 0.0) < 0.02
    assert rate(1000, 0.0) == pytest.approx(1.0)
    assert rate(1000, 0.5 * math.pi) == pytest.approx(0.5, abs=least)
    assert rate(1000, math.pi) == pytest.approx(least)


def test_every_epoch_passes_over_all_examples_in_another_order():
    epochs = [
        np.concatenate([rows_of_step(12, 4, 5, 3 * epoch + step) for step in range(3)])
        for epoch in range(2)
    ]
    for rows in epochs:
        assert sorted(rows) == list(range(12))
    assert (epochs[0] != epochs[1]).any()
    assert len(rows_of_step(3, 8, 5, 0)) == 3
