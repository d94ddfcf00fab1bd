"""Networks by name: delay and loss of one direction of published studies and of usual networks.

A link selects one with ``delay = { law = "preset", name = "wifi6" }``; ``cosim delays`` lists them.
A preset whose `source` begins with "constructed" is a law of this project with the medians, tails
and bursts that the named sources report; the law itself is unpublished. If the two directions of a
network differ, there are two presets, NAME-up and NAME-down.

Source: own construction or a publication, in the `source` of each preset.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.base.names import unknown

Table = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class LinkPreset:
    """One direction of a network: `delay` and `loss` as a scenario writes them."""

    title: str
    source: str
    delay: Table
    loss: Table | None = None

    @property
    def constructed(self) -> bool:
        """True if the law is one of this project and not published as it is."""
        return self.source.startswith("constructed")


def preset(name: str) -> LinkPreset:
    """The preset of that name. Raises ScenarioError."""
    if name not in PRESETS:
        raise ScenarioError(unknown(name, PRESETS, "preset of a network"))
    return PRESETS[name]


# ---- laws, as a scenario writes them ------------------------------------------------------------


def _constant(delay: str) -> Table:
    return {"law": "constant", "delay": delay}


def _gamma(shift: str, mean_s: float, variation: float, maximum: str) -> Table:
    """Shifted gamma by the mean (s) and the coefficient of variation of what is added."""
    shape = variation**-2
    return {
        "law": "gamma", "shift": shift, "shape": shape, "scale": mean_s / shape,
        "maximum": maximum,
    }  # fmt: skip


def _normal(mean: str, sd: str, maximum: str) -> Table:
    return {"law": "normal", "mean": mean, "sd": sd, "minimum": "5 ms", "maximum": maximum}


def _hyperexponential(
    shift: str, first: float, rates: tuple[float, float], maximum: str, hold: str | None = None
) -> Table:
    """By the weight of the first part and both rates, 1/ms."""
    return {
        "law": "hyperexponential", "shift": shift, "weights": [first, 1 - first],
        "means": [1e-3 / rate for rate in rates], "maximum": maximum, "hold": hold,
    }  # fmt: skip


def _independent(p: float) -> Table:
    return {"law": "independent", "p": p}


def _gilbert(share: float, burst: float) -> Table:
    """Simple Gilbert loss by the share of packets lost and the mean length of a burst, packets."""
    return {"law": "gilbert-elliott", "p": share / (burst * (1 - share)), "r": 1 / burst}


def _pareto(good: tuple[float, float], bad: tuple[float, float]) -> Table:
    """NetFI's bursts by (shape, scale) in the good and in the bad state."""
    return {
        "law": "pareto-bursts",
        "stay": [0.95, 0.90],
        "shape": [good[0], bad[0]],
        "scale": [good[1], bad[1]],
    }


def _outages(longest: str, pause: str) -> Table:
    return {"law": "outage", "length": 0, "longest": longest, "pause": pause}


def _leo(lowest: str, highest: str) -> Table:
    """A level for each 15 s, spikes of 40 ms for 107 ms twice in 15 s on average, and jitter."""
    return {
        "law": "sum",
        "of": [
            {"law": "uniform", "low": lowest, "high": highest, "hold": "15 s"},
            {"law": "markov", "levels": [0.0, 0.040], "dwell": [7.4, 0.107], "step": "1 ms"},
            _gamma("0 ms", 0.002, 1.0, "40 ms"),
        ],
    }


_TELESIM = "TeleSim, arXiv 2507.04425: the settings of its tier, in each direction"
_NETFI = "NetFI, arXiv 2603.06824:"
_CONSTRUCTED = "constructed from"
#: Loss of 20 % in windows of 107 ms (about 21 packets of 5 ms) that make 1.4 % of the time.
_HANDOVER: Table = {"law": "gilbert-elliott", "p": 0.000676, "r": 0.0465, "1-h": 0.2, "1-k": 0.003}

PRESETS: Mapping[str, LinkPreset] = {
    "paper": LinkPreset(
        "0.3 s + U[0, 0.9] s, redrawn every 30 ms",
        "H. Wang, Towards Manipulability of Interactive Lagrangian Systems, Sec. VII",
        {"law": "uniform", "low": "300 ms", "high": "1200 ms", "hold": "30 ms"},
    ),
    "telesim-high": LinkPreset(
        "N(100, 25²) ms, 0.1 % lost", _TELESIM, _normal("100 ms", "25 ms", "250 ms"),
        _independent(0.001),
    ),
    "telesim-medium": LinkPreset(
        "N(400, 50²) ms, 1 % lost", _TELESIM, _normal("400 ms", "50 ms", "700 ms"),
        _independent(0.01),
    ),
    "telesim-low": LinkPreset(
        "N(1000, 200²) ms, 3 % lost", _TELESIM, _normal("1 s", "200 ms", "2200 ms"),
        _independent(0.03),
    ),
    "netfi-dlm-1": LinkPreset(
        "hyperexponential, mean 100 ms", f"{_NETFI} DLM-1",
        _hyperexponential("70 ms", 0.72645, (0.02711, 0.08529), "1 s"),
    ),
    "netfi-dlm-2": LinkPreset(
        "hyperexponential, mean 299 ms", f"{_NETFI} DLM-2",
        _hyperexponential("210 ms", 0.89258, (0.01081, 0.01624), "2 s"),
    ),
    "netfi-dlm-3": LinkPreset(
        "hyperexponential, mean 500 ms", f"{_NETFI} DLM-3",
        _hyperexponential("406 ms", 0.89574, (0.01025, 0.01551), "2500 ms"),
    ),
    "netfi-4g": LinkPreset(
        "hyperexponential, mean 53 ms", f"{_NETFI} the tool's default, 4G",
        _hyperexponential("15 ms", 0.8, (0.1, 0.0067), "3 s"),
    ),
    "netfi-plm-1": LinkPreset(
        "10 % lost in bursts, delay 5 ms", f"{_NETFI} PLM-1; the delay is ours",
        _constant("5 ms"), _pareto((4.428, 1.638), (4.966, 0.271)),
    ),
    "netfi-plm-2": LinkPreset(
        "30 % lost in bursts, delay 5 ms", f"{_NETFI} PLM-2; the delay is ours",
        _constant("5 ms"), _pareto((4.604, 3.552), (3.901, 1.466)),
    ),
    "netfi-plm-3": LinkPreset(
        "50 % lost in bursts, delay 5 ms", f"{_NETFI} PLM-3; the delay is ours",
        _constant("5 ms"), _pareto((3.859, 3.324), (3.797, 6.049)),
    ),
    "netfi-clm-1": LinkPreset(
        "outages U[0, 3] s, 8.5 s apart, delay 5 ms", f"{_NETFI} CLM-1; the delay is ours",
        _constant("5 ms"), _outages("3 s", "8500 ms"),
    ),
    "netfi-clm-2": LinkPreset(
        "outages U[0, 1] s, 1 s apart, delay 5 ms", f"{_NETFI} CLM-2; the delay is ours",
        _constant("5 ms"), _outages("1 s", "1 s"),
    ),
    "netfi-clm-3": LinkPreset(
        "outages U[0, 2] s, 1 s apart, delay 5 ms", f"{_NETFI} CLM-3; the delay is ours",
        _constant("5 ms"), _outages("2 s", "1 s"),
    ),
    "lan": LinkPreset(
        "switched network, mean 0.1 ms", f"{_CONSTRUCTED} common round trips of 0.2 to 1 ms",
        _gamma("0.08 ms", 0.00003, 1.0, "1 ms"),
    ),
    "wifi5": LinkPreset(
        "home network in use, mean 7 ms, 1 % lost in pairs",
        f"{_CONSTRUCTED} a published 24 h ping (2022) and test presets of str0m",
        _gamma("3 ms", 0.004, 1.5, "500 ms"), _gilbert(0.01, 2.0),
    ),
    "wifi6": LinkPreset(
        "80 MHz, mean 4 ms, 0.2 % lost",
        f"{_CONSTRUCTED} published measurements of IEEE 802.11ax: 99 % below 10 ms",
        _gamma("2 ms", 0.002, 1.0, "100 ms"), _gilbert(0.002, 1.5),
    ),
    "wifi6-roaming": LinkPreset(
        "wifi6, and an outage of 150 ms every minute for a handover",
        f"{_CONSTRUCTED} a vendor's guide: 50 to 500 ms a handover",
        _gamma("2 ms", 0.002, 1.0, "100 ms"),
        {"law": "outage", "length": "150 ms", "every": "60 s", "start": "30 s"},
    ),
    "lte-up": LinkPreset(
        "4G uplink, mean 53 ms with a long tail, redrawn every 200 ms, 0.3 % lost",
        f"{_CONSTRUCTED} NetFI's 4G law and an uplink trace (mean 52 ms, 95 % below 140 ms)",
        _hyperexponential("15 ms", 0.8, (0.1, 0.0067), "3 s", "200 ms"), _gilbert(0.003, 2.0),
    ),
    "lte-down": LinkPreset(
        "4G downlink, mean 36 ms, redrawn every 200 ms, 0.3 % lost",
        f"{_CONSTRUCTED} usual round trips of 40 to 120 ms",
        _hyperexponential("12 ms", 0.9, (0.1, 0.0067), "3 s", "200 ms"), _gilbert(0.003, 2.0),
    ),
    "5g-up": LinkPreset(
        "5G (NSA) uplink, mean 16 ms, 0.1 % lost",
        f"{_CONSTRUCTED} a public network in Munich, 2022: one way 7 to 18 ms",
        _gamma("12 ms", 0.004, 1.0, "200 ms"), _independent(0.001),
    ),
    "5g-down": LinkPreset(
        "5G (NSA) downlink, mean 9 ms, 0.1 % lost",
        f"{_CONSTRUCTED} a public network in Munich, 2022: one way 7 to 18 ms",
        _gamma("7 ms", 0.002, 1.0, "200 ms"), _independent(0.001),
    ),
    "leo-up": LinkPreset(
        "satellite in low orbit, uplink, mean 28 ms, levels of 15 s, spikes",
        f"{_CONSTRUCTED} arXiv 2601.08439 and measurements of Starlink 2022 to 2025",
        _leo("18 ms", "33 ms"), _HANDOVER,
    ),
    "leo-down": LinkPreset(
        "satellite in low orbit, downlink, mean 22 ms, levels of 15 s, spikes",
        f"{_CONSTRUCTED} arXiv 2601.08439 and measurements of Starlink 2022 to 2025",
        _leo("12 ms", "27 ms"), _HANDOVER,
    ),
    "geo": LinkPreset(
        "geostationary satellite, mean 310 ms, 0.5 % lost in threes",
        f"{_CONSTRUCTED} propagation (239 to 284 ms) and usual round trips of 600 to 650 ms",
        _gamma("300 ms", 0.010, 1.0, "600 ms"), _gilbert(0.005, 3.0),
    ),
    "atlantic": LinkPreset(
        "Frankfurt to New York, N(42.5, 1.5²) ms, 0.05 % lost",
        f"{_CONSTRUCTED} a round trip of 85 ms (fibre: at least 61 ms)",
        _normal("42.5 ms", "1.5 ms", "60 ms"), _independent(0.0005),
    ),
    "pacific": LinkPreset(
        "Frankfurt to Tokyo, N(115, 2²) ms, 0.1 % lost",
        f"{_CONSTRUCTED} a round trip of 230 ms (fibre: at least 92 ms)",
        _normal("115 ms", "2 ms", "150 ms"), _independent(0.001),
    ),
}  # fmt: skip
