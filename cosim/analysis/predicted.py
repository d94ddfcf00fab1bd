"""Predictions of the tests of a port by closed forms, for networks that take long to test."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, nan

from cosim.analysis.contacts import margin
from cosim.analysis.experiments import Bench
from cosim.analysis.force_tests import (
    PortSweep,
    by_frequency,
    closed_gain,
    each_feedback,
    title_of,
    with_known,
)
from cosim.analysis.quantity import Quantity, quantity
from cosim.base.copies import replace
from cosim.predict import closed_form as closed
from cosim.predict.elimination import quick_rows

#: Components beyond which a port is not tested unless that is asked for.
MANY = 500
#: What is said of each number.
UNTESTED = "not tested"


def predicted(bench: Bench, lowest: float) -> Iterator[Quantity]:
    """The quantities of the tests that have a closed form, without values that were found.

    `lowest`: the lowest frequency, rad/s. Nothing where the port has no network.
    """
    net = bench.network
    if net is None:
        return
    if len(net.laws) * bench.size <= quick_rows():
        for b in (bench, with_known(bench)):
            if b is not None:
                form = closed_gain(b, net, b.frequencies(lowest))
                swept = PortSweep(title_of(b), form, form)
                yield from (_untested(q) for q in by_frequency(swept, b))
    K = each_feedback(net, len(bench.q))
    name, label, felt = (
        "push_damping",
        "felt damping, push",
        closed.felt_when_pushed(net, bench.q, K),
    )
    if not all(map(isfinite, felt)):
        name, label = "push_stiffness", "felt stiffness, push"
        felt = [closed.felt_stiffness(net, k) for k in K]
    yield quantity(
        name, label, nan, bench.units[name.removeprefix("push_")],
        "constant push on every joint, from rest, M_hat = M", expected=felt,
        formula="A(p)/p for p -> 0, mean graph", note=UNTESTED,
    )  # fmt: skip
    yield from margin(bench)


def _untested(q: Quantity) -> Quantity:
    note = f"{UNTESTED}; by the closed form {q.note}" if q.note else UNTESTED
    return replace(q, values=(nan,), error=(), note=note)
