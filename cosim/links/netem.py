"""The nearest thing ``tc netem`` can do: a law and a loss as arguments for a real interface.

The first line of :func:`netem` goes after ``tc qdisc add dev DEV root netem``; lines that start
with ``#`` say where netem does something else, and paste into a shell as they are. What netem
does is taken from Linux (net/sched/sch_netem.c) and iproute2 (tc-netem(8)):

* ``delay M J`` without a distribution is uniform on [M - J, M + J) in the kernel, whatever the
  manual says of a normal default; ``distribution uniform`` looks for a file that is not shipped.
* Every packet is drawn anew and leaves when its delay is over: packets overtake each other.
  With a ``rate`` a packet leaves after the one before it, as `fifo` does.
* A queue holds ``limit`` packets, 1000 unless said; what is too many is dropped.
* It draws differently every time: for the same run twice, replay a table.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from math import ceil, exp

import numpy as np

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.distributions import Gamma, Hyperexponential, Lognormal, Normal
from cosim.links.laws import Constant, FloatArray, Law, Sum, Uniform
from cosim.links.losses import GilbertElliott, Independent, Loss, Lossy
from cosim.links.markov import Markov
from cosim.links.outages import Outage, RandomOutage
from cosim.links.segments import Segments
from cosim.links.traces import DelayTrace

LIMIT = 1000  # packets, netem's own
JITTER_MAXIMUM = 2.147483647  # s; netem keeps it as a signed 32-bit number of nanoseconds
SCALE = 8192  # a table entry of this size is one jitter
REACH = 3.999  # jitters; entries are signed 16-bit numbers
ENTRIES = 4096  # of a distribution table
DRAWS = 1 << 18  # of which its quantiles are taken

PERIOD = Fraction(1, 100)  # s, at which a trace is looked up for them

_HELD = (Gamma, Lognormal, Normal, Hyperexponential)

Parts = tuple[list[str], list[str]]  # arguments, remarks


def netem(law: Law, loss: Loss | None = None, *, period: float | None = None) -> str:
    """Arguments for ``tc netem`` that approximate a link, and remarks on the differences.

    `loss`: a loss model, if `law` has none; `period`: time between two packets (s), which
    determines the queue's limit, overtaking, and outages in packets. Raises ScenarioError for an
    invalid period, and for a law that no arguments can express.
    """
    if period is not None and not period > 0:
        raise ScenarioError(f"period = {period:g} s; expected more than 0")
    if isinstance(law, Lossy):
        if loss is not None:
            raise ScenarioError("found a lossy delay law and a loss model; netem supports one loss")
        return netem(law.delay, law.loss, period=period)
    delay, delay_remarks = _delay(law)
    lost, loss_remarks = _trace_loss(law, loss) if loss is None else _loss(loss, period)
    limit, limit_remarks = _limit(law, period)
    remarks = [*delay_remarks, *_order(law, period), *loss_remarks, *limit_remarks]
    if loss is not None and law.loses_packets:
        remarks.append("the losses of the trace itself are left out: netem takes one loss model")
    line = " ".join([*limit, *delay, *lost])
    return "\n".join([line, *(f"# {remark}" for remark in remarks)])


def distribution_table(law: Law) -> str:
    """The text of the file NAME.dist that :func:`netem` means by ``distribution NAME``.

    4096 quantiles (of a continuous law: of 2^18 draws), in jitters/8192 from the mean. tc looks
    for the file in the folder TC_LIB_DIR, if that is set, or where its own are (/usr/lib/tc).
    Raises ScenarioError for a law that needs none.
    """
    law = law.delay if isinstance(law, Lossy) else law
    name = _distribution(law)
    if name is None:
        raise ScenarioError(f"netem needs no table for law = {law.facts()['law']!r}")
    share = (np.arange(ENTRIES) + 0.5) / ENTRIES
    entries = np.rint((_quantiles(law, share) - law.mean) / _jitter(law) * SCALE).astype(int)
    lines = [" ".join(map(str, row)) for row in entries.reshape(-1, 8).tolist()]
    return "\n".join([f"# {law.facts()}", *lines, ""])


def _quantiles(law: Law, share: FloatArray) -> FloatArray:
    """The delays (s) that are not exceeded by each share of all, (n,)."""
    if isinstance(law, Markov):
        order = np.argsort(law.levels)
        reached = np.cumsum(law.shares[order])[:-1]
        levels: FloatArray = np.array(law.levels)[order][np.searchsorted(reached, share)]
        return levels
    if isinstance(law, _HELD):
        law = replace(law, hold=None)
    limit = law.limit(PERIOD)
    T = law.stream(PERIOD, generator(0, "netem")).take(DRAWS if limit is None else limit)
    quantiles: FloatArray = np.quantile(T[np.isfinite(T)], share, method="inverted_cdf")
    return quantiles


def _delay(law: Law) -> Parts:
    if isinstance(law, Segments):
        return ["delay", _time(law.delay)], list(_segments(law))
    if law.maximum == law.minimum:
        return ["delay", _time(law.minimum)], []
    name, jitter = _distribution(law), _jitter(law)
    arguments, remarks = ["delay", _time(law.mean), _time(jitter)], []
    if name is not None:
        arguments += ["distribution", name]
        remarks.append(f"tc needs a file {name}.dist for this law; distribution_table() writes it")
    if jitter > JITTER_MAXIMUM:
        remarks.append(f"netem cuts a jitter of {_time(jitter)} to {_time(JITTER_MAXIMUM)}")
    match law:
        case Uniform(hold=float(hold)) | Gamma(hold=float(hold)) | Lognormal(hold=float(hold)):
            remarks.append(_kept(hold))
        case Normal(hold=float(hold)) | Hyperexponential(hold=float(hold)):
            remarks.append(_kept(hold))
        case Sum():
            remarks.append("netem keeps how often each delay of the sum occurs, not their order")
        case Markov():
            remarks.append(
                "netem keeps how often each level occurs, not how long it lasts: it has no chain"
            )
        case DelayTrace():
            remarks.append("netem keeps how often each delay of the trace occurs, not their order")
        case _:
            pass
    return arguments, remarks


def _segments(law: Segments) -> Iterator[str]:
    for x in law.segments:
        value = "loss 100%" if x.delay is None else f"delay {_time(x.delay)}"
        yield f"from {x.begin:g} s to {x.end:g} s a script has to set {value}"
    for verb, speed in (("rises", law.rise), ("falls", law.fall)):
        if speed is not None:
            yield f"the delay {verb} by at most {speed:g} s in a second: a script has to set steps"


def _kept(hold: float) -> str:
    return f"netem draws for every packet; this law keeps a draw for {_time(hold)}"


def _distribution(law: Law) -> str | None:
    """The name of a law's distribution table; None: netem needs none."""
    if law.maximum == law.minimum or isinstance(law, Constant | Uniform):
        return None
    return str(law.facts()["law"])


def _jitter(law: Law) -> float:
    """Half the width of a uniform law; else as much as reaches from the mean to both bounds, s."""
    reach = max(law.maximum - law.mean, law.mean - law.minimum)
    return reach if isinstance(law, Uniform) else reach / REACH


def _order(law: Law, period: float | None) -> list[str]:
    spread = law.maximum - law.minimum
    if spread == 0 or (period is not None and spread <= period):
        return []
    by = f"up to {_time(spread)}"
    gap = "" if period is None else f", more than the {_time(period)} between packets"
    return [
        f"delays differ by {by}{gap}: netem lets packets overtake each other, as last-arrival and"
        " newest-stamp expect; fifo: add rate 1gbit, which makes them queue"
    ]


def _limit(law: Law, period: float | None) -> Parts:
    waiting = 0 if period is None else ceil(law.maximum / period) + 1
    if waiting <= LIMIT:
        return [], []
    return ["limit", str(waiting)], [
        f"up to {waiting} packets wait at once; netem would drop those beyond {LIMIT}"
    ]


def _trace_loss(law: Law, loss: None) -> Parts:
    if not isinstance(law, DelayTrace) or not law.loses_packets:
        return [], []
    share = float(np.mean(~np.isfinite(law.delay)))
    return ["loss", "random", _percent(share)], [
        "netem loses as many packets as the trace, one independent of the other"
    ]


def _loss(loss: Loss, period: float | None) -> Parts:
    match loss:
        case Independent():
            return ["loss", "random", _percent(loss.p)], []
        case GilbertElliott():
            values = (loss.p, loss.r, loss.bad, loss.good)
            return ["loss", "gemodel", *map(_percent, values)], []
        case Outage():
            words, rate = f"every {_time(loss.every)}", 1 / (loss.every - loss.length)
        case RandomOutage():
            words, rate = f"at random, {loss.rate:g} a second", loss.rate
        case _:
            raise ScenarioError(f"netem has no equivalent of loss.law = {loss.facts()['law']!r}")
    if period is None:
        return [], [
            f"netem has no outages in time: here {_time(loss.length)} {words}; have a script set"
            " loss 100% meanwhile"
        ]
    p, r = 1 - exp(-rate * period), min(1.0, period / loss.length)
    return ["loss", "gemodel", _percent(p), _percent(r), "100%", "0%"], [
        f"netem has no outages in time: here exactly {_time(loss.length)} {words}; in netem"
        f" {1 / r:g} packets in the mean"
    ]


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.9g}ms"


def _percent(share: float) -> str:
    return f"{100 * share:.6g}%"
