"""The structs that a scenario's links are decoded into: a struct for each delay law and loss model.

Numbers are seconds; a text has its unit. :mod:`cosim.links.spec` makes laws and models of them.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

Seconds = int | float | str
Number = int | float | str  # without a dimension, or with the one that is said


class _Law(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law"):
    """One of several laws, selected by `law`; unknown keys are errors."""


class ConstantDelay(_Law, frozen=True, tag="constant"):
    """T = delay."""

    delay: Seconds


class UniformDelay(_Law, frozen=True, tag="uniform"):
    """T ~ U[low, high], drawn every `hold`, or for every sample."""

    low: Seconds
    high: Seconds
    hold: Seconds | None = None


class GammaDelay(_Law, frozen=True, tag="gamma"):
    """T = min(shift + scale·g, maximum), g ~ Gamma(shape), drawn every `hold`."""

    shift: Seconds
    shape: Number
    scale: Seconds
    maximum: Seconds
    hold: Seconds | None = None


class LognormalDelay(_Law, frozen=True, tag="lognormal"):
    """T = min(shift + median·exp(sigma·g), maximum), g ~ N(0, 1), drawn every `hold`."""

    shift: Seconds
    median: Seconds
    sigma: Number
    maximum: Seconds
    hold: Seconds | None = None


class MarkovDelay(_Law, frozen=True, tag="markov"):
    """T jumps between levels every `step`, by probabilities or by mean times on each level."""

    levels: tuple[Seconds, ...]
    step: Seconds
    transitions: tuple[tuple[float, ...], ...] | None = None
    dwell: Seconds | tuple[Seconds, ...] | None = None


class NormalDelay(_Law, frozen=True, tag="normal"):
    """T = mean + sd·g, g ~ N(0, 1), cut to [minimum, maximum], drawn every `hold`."""

    mean: Seconds
    sd: Seconds
    maximum: Seconds
    minimum: Seconds = 0
    hold: Seconds | None = None


class HyperexponentialDelay(_Law, frozen=True, tag="hyperexponential"):
    """T = min(shift + e, maximum): e is exponential, with mean means[i] by chance weights[i]."""

    shift: Seconds
    weights: tuple[float, ...]
    means: tuple[Seconds, ...]
    maximum: Seconds
    hold: Seconds | None = None


class SumDelay(_Law, frozen=True, tag="sum"):
    """T = the sum of independent laws, each a table like `delay` itself."""

    of: tuple[dict[str, Any], ...]


class PresetDelay(_Law, frozen=True, tag="preset"):
    """Delay and loss of a named network, see :mod:`cosim.links.presets`."""

    name: str


class FrozenDelay(_Law, frozen=True, tag="frozen"):
    """A delay trace with fixed bytes, see :mod:`cosim.links.frozen_traces`."""

    name: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False


class TraceDelay(_Law, frozen=True, tag="trace"):
    """T from a file of measured delays (CSV or Parquet: t_send, delay)."""

    file: str
    lookup: Literal["time", "index"] = "time"
    repeat: bool = False


class TableDelay(_Law, frozen=True, tag="table"):
    """The stored table of a link; it already contains the effect of the semantics."""

    file: str


class IndependentLoss(_Law, frozen=True, tag="independent"):
    """Each packet is lost with probability p."""

    p: Number


class GilbertElliottLoss(
    _Law, frozen=True, tag="gilbert-elliott", rename={"bad": "1-h", "good": "1-k"}
):
    """netem's ``loss gemodel p [r [1-h [1-k]]]``, with its defaults: r = 1 - p, 1, 0."""

    p: Number
    r: Number | None = None
    bad: Number = 1
    good: Number = 0


class OutageLoss(_Law, frozen=True, tag="outage"):
    """Outages of `length`: one `every` so often (first at `start`), or at random with `rate`.

    With `longest` and `pause` instead: of random length, U[length, longest], and `pause` apart.
    """

    length: Seconds
    every: Seconds | None = None
    start: Seconds | None = None
    rate: Number | None = None
    longest: Seconds | None = None
    pause: Seconds | None = None


class ParetoBurstLoss(_Law, frozen=True, tag="pareto-bursts"):
    """Bursts of Pareto length (Lomax: `shape`, `scale`), each of two states with its own.

    `stay`: probability of staying in the first and in the second state, each packet.
    """

    stay: tuple[float, float]
    shape: tuple[float, float]
    scale: tuple[float, float]


DelaySpec = (
    ConstantDelay
    | UniformDelay
    | GammaDelay
    | LognormalDelay
    | MarkovDelay
    | NormalDelay
    | HyperexponentialDelay
    | SumDelay
    | PresetDelay
    | FrozenDelay
    | TraceDelay
    | TableDelay
)
LossSpec = IndependentLoss | GilbertElliottLoss | OutageLoss | ParetoBurstLoss
