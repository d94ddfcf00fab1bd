"""Clocks that are mixed in one stream: found, named, and the samples of the commonest one kept.

Two kinds of stamps in one stream are simulated time beside wall time (more than a day apart), or
two senders with clocks that differ. A delay that jumps is not taken for it: the stamps of each
sender are regular by themselves, and a step of a clock shows in the stamps and not in the arrivals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bridge.captures.ways import REGULAR, Marks
from bridge.ping.exchanges import Integers
from bridge.ping.listening import FOREIGN

#: The gap between two groups of ages, in widths of the wider one; the least gap, ns; the smallest
#: part of the samples that is a group.
GAP, LEAST, SHARE = 3.0, 1_000_000, 0.05
_FAR = round(FOREIGN * 1e9)


class OneClock(NamedTuple):
    """The samples of one clock, a mask (n,), and what the others are, in sentences."""

    kept: Marks
    remarks: list[str]


def one_clock(t: Integers, stamps: Integers) -> OneClock:
    """The samples with stamps of the commonest clock. `t`, `stamps` (n,): recorded and sent, ns, in
    the order of the recording.
    """
    everything = np.ones(t.size, dtype=bool)
    age = t - stamps
    far = np.abs(age) > _FAR
    count = int(far.sum())
    if 0 < count < t.size:
        kept = far if 2 * count > t.size else ~far
        return OneClock(
            kept,
            [
                f"two clocks are mixed in this stream: {count} stamps are more than a day from the "
                f"recording's times, as simulated time is, and {t.size - count} are not; the "
                f"{'latter' if 2 * count > t.size else 'former'} are left out"
            ],
        )
    groups = _groups(age)
    if groups is None:
        return OneClock(everything, [])
    older, gap = groups
    switches = np.flatnonzero(np.diff(older.astype(np.int8)))
    if switches.size <= max(4, t.size // 500):
        return _jumps(t, stamps, switches, gap)
    if _regular(stamps[older]) and _regular(stamps[~older]):
        kept = older if 2 * int(older.sum()) > t.size else ~older
        lost = int(t.size - kept.sum())
        return OneClock(
            kept,
            [
                "two clocks are mixed in this stream: the stamps of two senders or hosts are "
                f"{gap * 1e-9:.6g} s apart, {int(older.sum())} older and {int((~older).sum())} "
                f"newer; the {lost} fewer ones are left out"
            ],
        )
    return OneClock(everything, [])


def _groups(age: Integers) -> tuple[Marks, int] | None:
    """The samples of the older of two groups of ages (n,), ns, and how far they are apart."""
    least = max(5, round(SHARE * age.size))
    if age.size < 4 * least:
        return None
    ordered = np.sort(age)
    gaps = np.diff(ordered)[least - 1 : age.size - least]
    at = int(np.argmax(gaps)) + least - 1
    width = max(_width(ordered[: at + 1]), _width(ordered[at + 1 :]))
    gap = int(ordered[at + 1] - ordered[at])
    if gap < LEAST or gap < GAP * width:
        return None
    apart = int(np.median(ordered[at + 1 :]) - np.median(ordered[: at + 1]))
    return age > ordered[at], apart


def _width(ordered: Integers) -> float:
    low, high = np.quantile(ordered, (0.05, 0.95))
    return float(high - low)


def _regular(stamps: Integers) -> bool:
    steps = np.diff(np.sort(stamps))
    median = int(np.median(steps))
    return median > 0 and float(np.quantile(np.abs(steps - median), 0.9)) <= REGULAR * median


def _jumps(t: Integers, stamps: Integers, switches: Integers, gap: int) -> OneClock:
    """The longest part between jumps of a clock, ages `gap` ns apart; `switches`: where they are.

    The clock of the stamps jumps where they do and arrivals do not; that of the recording where
    its times go back.
    """
    remarks, ends = [], []
    for i in switches.tolist():
        sent, came = int(stamps[i + 1] - stamps[i]), int(t[i + 1] - t[i])
        if abs(sent) > gap / 2 and abs(came) < gap / 2:
            whose, step = "stamps", sent
        elif came < -gap / 2:
            whose, step = "recording", came
        else:
            continue
        at = (int(t[i]) - int(t[0])) * 1e-9
        remarks.append(f"the clock of the {whose} jumped by {step * 1e-9:+.6g} s at {at:.3f} s")
        ends.append(i + 1)
    kept = np.zeros(t.size, dtype=bool)
    edges = [0, *ends, t.size]
    longest = int(np.argmax(np.diff(edges)))
    kept[edges[longest] : edges[longest + 1]] = True
    if remarks:
        remarks.append(f"the longest part without a jump is used, {int(kept.sum())} samples")
    return OneClock(kept, remarks)
