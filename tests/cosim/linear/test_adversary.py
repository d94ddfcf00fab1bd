"""The greedy adversary of a linear model: what it may choose, and what it reaches."""

from __future__ import annotations

import numpy as np

from cosim.linear.adversary import SampleChoices, attacks

RNG = np.random.default_rng(5)
A = 0.95 * np.linalg.qr(RNG.normal(size=(4, 4)))[0]
B, C = RNG.normal(size=(4, 1)), RNG.normal(size=(1, 4))
START = RNG.normal(size=4)


def choices(ages, grows=None):
    before = np.array(ages)[:, None]
    return SampleChoices(np.array([0]), np.zeros_like(before), before, grows)


def played(ages, D):
    """The states when a receiver holds samples of these ages; before the start those at it."""
    x, sent, states = START, [], []
    for k, age in enumerate(ages):
        now = C @ x
        u = sent[k - age] if 0 < age <= k else C @ START if age else now
        sent.append(now + D @ u)
        x = A @ x + B @ u
        states.append(x)
    return np.array(states)


def test_a_motion_is_that_of_the_model_with_the_chosen_samples():
    for D, ages in ((np.zeros((1, 1)), [0, 1, 4]), (np.array([[0.3]]), [1, 2, 5])):
        for attack in attacks((A, B, C, D), [choices(ages)], START, 60, 0.01):
            states = played(np.array(ages)[attack.chosen[0]], D)
            change = np.abs(np.diff(np.vstack([START, states]), axis=0)).max(axis=1)
            np.testing.assert_allclose(np.exp(attack.size), change, rtol=1e-9)


def test_samples_in_order_are_no_more_than_one_further():
    ages, none = list(range(7)), np.zeros((1, 1))
    steps = [
        [np.diff(a.chosen[0]).max() for a in attacks((A, B, C, none), [one], START, 200, 0.01)]
        for one in (choices(ages), choices(ages, 1))
    ]
    assert min(steps[0]) > 1 and max(steps[1]) == 1


def test_a_motion_that_grows_without_bound_is_scaled():
    found = attacks((1.2 * A, B, C, np.zeros((1, 1))), [choices([0, 3])], START, 5000, 0.01)
    assert min(a.size[-1] for a in found) > 500 and all(np.isfinite(a.size).all() for a in found)
