"""Frozen delay traces: delays whose bytes are the same on every machine and in every version.

A comparison with a published table requires exactly the same delays. A law and a seed do not
guarantee this, because another version of NumPy or another processor may round a logarithm
differently. These traces are therefore computed with integers only, by the following algorithm,
which any language can implement. Each has the SHA-256 sum of its CSV text, which
:meth:`FrozenTrace.text` checks.

Random numbers: SplitMix64. Word i = 1, 2, … of stream s is, modulo 2^64, with x = seed + (s·2^40 +
i)·0x9E3779B97F4A7C15::

    x = (x xor x >> 30)·0xBF58476D1CE4E5B9;  x = (x xor x >> 27)·0x94D049BB133111EB
    word = (x xor x >> 31) >> 32;  u = floor(word·10^6 / 2^32)          0 … 999999

Row k = 0, 1, …, 23999 is a packet sent at 5·k ms. Its delay in µs is the sum of

* `quantiles` at u of word 1 + floor(k / hold) of stream 0: the value between two knots (u, µs) is
  a + floor((b - a)(u - u_a)/(u_b - u_a));
* a level, low + floor((high - low)·u/10^6), u of word 1 + floor(k / rows) of stream 1;
* `spike` µs where k modulo `rows` is in one of the windows.

``queue``: packets leave in order: T_k is at least T_(k-1) - 5000 µs, including lost packets. A
packet is lost in the bad one of two states. The state is good before the first row and changes
before row k if u of word 1 + k of stream 2 is below `enter` (in the good state) or `leave`.

CSV: UTF-8, lines end with LF; the header ``t_send,delay``; t_send in s with 3 decimals, the delay
in s with 6, empty for a lost packet. :func:`cosim.links.traces.read_trace` reads this format, and
Parquet files with the same two columns.

Source: own construction; SplitMix64 is by G. L. Steele, D. Lea, C. H. Flood, "Fast splittable
pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.base.names import unknown
from cosim.links.laws import BoolArray, IntArray
from cosim.links.traces import DelayTrace

#: Rows of a trace, and µs between two of them: 120 s.
ROWS, INTERVAL = 24_000, 5_000
_MILLION = 1_000_000

Knots = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Levels:
    """A level, U[low, high] µs for `rows` rows each, and spikes in `windows` of [first, last)."""

    rows: int
    low: int
    high: int
    spike: int = 0
    windows: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class FrozenTrace:
    """A recipe; see the module for what its values mean. `sha256`: of the CSV text."""

    title: str
    seed: int
    quantiles: Knots
    sha256: str
    hold: int = 1
    queue: bool = False
    enter: int = 0
    leave: int = _MILLION
    levels: Levels | None = None

    def delays(self) -> IntArray:
        """The delays, (ROWS,), µs; -1 where the packet is lost."""
        k = np.arange(ROWS, dtype=np.int64)
        T = _interpolated(self.quantiles, uniform(self.seed, 0, k // self.hold))
        if self.levels is not None:
            T = T + _level(self.levels, self.seed, k)
        if self.queue:  # T_k + 5000 k never falls
            T = np.maximum.accumulate(T + INTERVAL * k) - INTERVAL * k
        return np.where(self._lost(), -1, T)

    def _lost(self) -> BoolArray:
        lost = np.zeros(ROWS, bool)
        if not self.enter:
            return lost
        bad = False
        for k, u in enumerate(uniform(self.seed, 2, np.arange(ROWS)).tolist()):
            bad = u >= self.leave if bad else u < self.enter
            lost[k] = bad
        return lost

    def text(self) -> str:
        """The CSV text. Raises ScenarioError where it has not the declared sum."""
        lines = ["t_send,delay"]
        for k, T in enumerate(self.delays().tolist()):
            ms = 5 * k
            delay = "" if T < 0 else f"{T // _MILLION}.{T % _MILLION:06d}"
            lines.append(f"{ms // 1000}.{ms % 1000:03d},{delay}")
        text = "\n".join(lines) + "\n"
        found = sha256(text.encode()).hexdigest()
        if found != self.sha256:
            raise ScenarioError(
                f"the trace {self.title!r} has the SHA-256 sum {found}; expected {self.sha256}"
            )
        return text

    def trace(self, *, lookup: str = "time", repeat: bool = False, name: str = "") -> DelayTrace:
        """The trace as a delay law; `lookup` and `repeat` as of DelayTrace.

        Raises ScenarioError where its text has not the declared sum.
        """
        self.text()
        T = self.delays()
        delay = np.where(T < 0, np.nan, T / _MILLION)
        return DelayTrace(np.arange(ROWS) * 5 / 1000, delay, lookup, repeat, name or self.title)


def uniform(seed: int, stream: int, index: NDArray[np.int64]) -> IntArray:
    """u, 0 to 999999, of word 1 + `index` (n,) of a stream, (n,): SplitMix64, see the module."""
    at = (index + 1).astype(np.uint64) + np.uint64(stream << 40)
    x = np.uint64(seed) + at * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    word = (x ^ (x >> np.uint64(31))) >> np.uint64(32)
    return np.asarray((word * np.uint64(_MILLION) >> np.uint64(32)).astype(np.int64))


def _interpolated(knots: Knots, u: IntArray) -> IntArray:
    T = np.full(u.shape, knots[0][1], np.int64)
    for (u_a, a), (u_b, b) in pairwise(knots):
        T = np.where(u >= u_a, a + (b - a) * (u - u_a) // (u_b - u_a), T)
    return T


def _level(levels: Levels, seed: int, k: NDArray[np.int64]) -> IntArray:
    u = uniform(seed, 1, k // levels.rows)
    T = levels.low + (levels.high - levels.low) * u // _MILLION
    phase = k % levels.rows
    for first, last in levels.windows:
        T = T + np.where((phase >= first) & (phase < last), levels.spike, 0)
    return np.asarray(T)


def frozen(name: str) -> FrozenTrace:
    """The trace of that name. Raises ScenarioError."""
    if name not in TRACES:
        raise ScenarioError(unknown(name, TRACES, "frozen trace"))
    return TRACES[name]


def write_traces(folder: Path) -> int:
    """Write every trace as NAME.csv, and SHA256SUMS, into a folder; their number.

    Raises RunError where it cannot be written, ScenarioError where a trace has not its sum.
    """
    texts = {f"{name}.csv": trace.text() for name, trace in TRACES.items()}
    sums = "".join(f"{trace.sha256}  {name}.csv\n" for name, trace in TRACES.items())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in {**texts, "SHA256SUMS": sums}.items():
            (folder / name).write_bytes(text.encode())
    except OSError as error:
        raise RunError(f"cannot write to {folder}: {error.strerror}") from error
    return len(TRACES)


# ---- the traces: knots of their quantiles, (u, µs) ----------------------------------------------

_PAPER: Knots = ((0, 300_000), (1_000_000, 1_200_000))
_TELESIM: Knots = (
    (0, 190_000), (1_000, 245_500), (10_000, 283_700), (50_000, 317_800),
    (100_000, 335_900), (250_000, 366_300), (500_000, 400_000), (750_000, 433_700),
    (900_000, 464_100), (950_000, 482_200), (990_000, 516_300), (999_000, 554_500),
    (1_000_000, 610_000),
)  # fmt: skip
_NETFI: Knots = (
    (0, 210_000), (50_000, 214_500), (100_000, 219_300), (250_000, 235_300), (500_000, 271_200),
    (750_000, 333_200), (900_000, 416_200), (950_000, 479_600), (990_000, 630_400),
    (999_000, 850_000), (1_000_000, 1_293_000),
)  # fmt: skip
_WIFI5: Knots = (
    (0, 3_000), (50_000, 3_008), (100_000, 3_038), (250_000, 3_309), (500_000, 4_628),
    (750_000, 8_128), (900_000, 14_020), (950_000, 18_960), (990_000, 31_360), (999_000, 50_570),
    (1_000_000, 82_000),
)  # fmt: skip
_LTE_UP: Knots = (
    (0, 15_000), (100_000, 16_300), (250_000, 18_700), (500_000, 24_400), (750_000, 36_000),
    (900_000, 60_000), (950_000, 95_000), (990_000, 260_000), (999_000, 700_000),
    (1_000_000, 1_000_000),
)  # fmt: skip
_LTE_DOWN: Knots = (
    (0, 12_000), (100_000, 13_200), (250_000, 15_200), (500_000, 20_000), (750_000, 29_000),
    (900_000, 45_000), (950_000, 65_000), (990_000, 180_000), (999_000, 500_000),
    (1_000_000, 800_000),
)  # fmt: skip
_EXPONENTIAL: Knots = (  # mean 2 ms
    (0, 0), (50_000, 103), (100_000, 211), (250_000, 575), (500_000, 1_386), (750_000, 2_773),
    (900_000, 4_605), (950_000, 5_991), (990_000, 9_210), (999_000, 13_816), (1_000_000, 27_000),
)  # fmt: skip


def _stretched(shift: int, factor: int) -> Knots:
    """`shift` µs and an exponential tail of mean 2·`factor` ms."""
    return tuple((u, shift + factor * T) for u, T in _EXPONENTIAL)


def _cycle(low: int, high: int) -> Levels:
    """A satellite's cycle of 15 s: 140 ms of spike at its start, 75 ms at its end."""
    return Levels(3_000, low, high, 40_000, ((0, 28), (2_985, 3_000)))


#: By name. What is called after a preset of :mod:`cosim.links.presets` is of the same network; in a
#: `queue` what waits behind a late packet is late as well, so that its tail is longer.
TRACES: Mapping[str, FrozenTrace] = {
    "paper-up": FrozenTrace(
        "0.3 s + U[0, 0.9] s, redrawn every 30 ms", 1, _PAPER,
        "2bb8db27a68d6e123878dda7209c9b45eb30d18cf2a3a2245f48c62a44cb1867",
        hold=6,
    ),
    "paper-down": FrozenTrace(
        "0.3 s + U[0, 0.9] s, redrawn every 30 ms", 2, _PAPER,
        "8c3d39fae077e65c61e3141c77ceb41f890d418fc4676616670f2131a4412dcb",
        hold=6,
    ),
    "telesim-medium-up": FrozenTrace(
        "N(400, 50²) ms, 1 % lost", 3, _TELESIM,
        "89b1de929efb4c63a30e0bd47f819bbca8392127622a628ad9163e28f993a8ab",
        enter=10_000, leave=990_000,
    ),
    "telesim-medium-down": FrozenTrace(
        "N(400, 50²) ms, 1 % lost", 4, _TELESIM,
        "7e6bcb010546eab9ca8b55efef58b2cbaa81b121fc6933627b14623724638905",
        enter=10_000, leave=990_000,
    ),
    "netfi-dlm-2-up": FrozenTrace(
        "hyperexponential, mean 299 ms", 5, _NETFI,
        "a977659aecf9d7d6496d6319ae47a1a90f3760d9b1f9169d678c32422749976a",
    ),
    "netfi-dlm-2-down": FrozenTrace(
        "hyperexponential, mean 299 ms", 6, _NETFI,
        "3a28c9b1cb9aaaf4b027c4817e068684dc7477bb5058c547fed1259aa50f3187",
    ),
    "wifi5-up": FrozenTrace(
        "home network, mean 7 ms, 1 % lost in pairs", 7, _WIFI5,
        "b0f998a347f8e8dd4d84d3ead96a4949bb4aa6c56b6725006dd693cd08307d7f",
        queue=True, enter=5_051, leave=500_000,
    ),
    "wifi5-down": FrozenTrace(
        "home network, mean 7 ms, 1 % lost in pairs", 8, _WIFI5,
        "aa763a33627e146eebbad3414fd78abd7ae169b23c6a0ee0d3d88d4d1d50baf7",
        queue=True, enter=5_051, leave=500_000,
    ),
    "lte-up": FrozenTrace(
        "4G, long tail, redrawn every 200 ms, 0.3 % lost", 9, _LTE_UP,
        "ff828d62b82c3f1eb5c9cca4f9f95b94f43c6eaac96ff9d7ca470cc220decbc6",
        hold=40, queue=True, enter=1_505, leave=500_000,
    ),
    "lte-down": FrozenTrace(
        "4G, long tail, redrawn every 200 ms, 0.3 % lost", 10, _LTE_DOWN,
        "685da54224d6b8968b88c8ac056148934e05f6b737bcb89ac0b13901037a69de",
        hold=40, queue=True, enter=1_505, leave=500_000,
    ),
    "5g-up": FrozenTrace(
        "5G, 0.1 % lost", 11, _stretched(12_000, 2),
        "00058c4f8ea82e21a241ea2ec1b13718f2b18e31a8b836979c563a8559a61272",
        queue=True, enter=1_000, leave=999_000,
    ),
    "5g-down": FrozenTrace(
        "5G, 0.1 % lost", 12, _stretched(7_000, 1),
        "e11a5688e9d6d143f6845582e32b7f8911796fbc85b117d228d3af42fb164b7c",
        queue=True, enter=1_000, leave=999_000,
    ),
    "leo-up": FrozenTrace(
        "satellite in low orbit, levels of 15 s, spikes, 0.4 % lost", 13, _EXPONENTIAL,
        "32a827807c1e1e0a2fe36d7efb43c39e874a8547ee4f62adfed02cb39617a7f4",
        queue=True, enter=4_000, leave=990_000, levels=_cycle(18_000, 33_000),
    ),
    "leo-down": FrozenTrace(
        "satellite in low orbit, levels of 15 s, spikes, 0.4 % lost", 14, _EXPONENTIAL,
        "c7de723a98ec25b1b12770078e9b447733bbb943271c649fb2181cc56ec93efc",
        queue=True, enter=4_000, leave=990_000, levels=_cycle(12_000, 27_000),
    ),
    "geo-up": FrozenTrace(
        "geostationary satellite, mean 310 ms, 0.5 % lost in threes", 15, _stretched(300_000, 5),
        "98008ccd6cd75944321983ee7a8402daca0c1bc803a34b3253ad897a540d6fe2",
        queue=True, enter=1_675, leave=333_333,
    ),
    "geo-down": FrozenTrace(
        "geostationary satellite, mean 310 ms, 0.5 % lost in threes", 16, _stretched(300_000, 5),
        "a31fa0e2baa979532a5e0ae7092f09c6161fa65cb544b9da73935a900340dda0",
        queue=True, enter=1_675, leave=333_333,
    ),
}  # fmt: skip
