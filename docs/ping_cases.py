"""Write the table of five networks in ``docs/network.md``: ``python docs/ping_cases.py``.

Each network is drawn for a minute at 200 packets a second in both directions, as `cosim ping`
would have measured it; what follows from it is computed as with ``--scenario --compare``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "network.md"
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from bridge.ping.figures import WayFigures, way_figures  # noqa: E402
from bridge.ping.prediction import ControllerSurvival, PathTrace, predict, survivors  # noqa: E402
from cosim.base.random_numbers import generator  # noqa: E402
from cosim.comparison.variants_file import variants_path  # noqa: E402
from cosim.links.laws import FloatArray  # noqa: E402
from cosim.links.spec import delay_law  # noqa: E402
from cosim.links.table import DrawnTable  # noqa: E402
from cosim.loading.files import load  # noqa: E402
from cosim.scenario.assemble import assemble  # noqa: E402

SCENARIO = ROOT / "configs" / "teleoperation.toml"
BUS = ROOT / "configs" / "can" / "teleoperation-bus.toml"
PERIOD, PACKETS = Fraction(5, 1000), 12_000
#: Of the bus: other traffic at higher priority, with the two xi about 90 % of 500 kbit/s.
LOADED = (
    "run.stop=60 s",
    "bus.can0={bitrate=500e3, traffic=[{kind='random', share=0.8}]}",
    "links.0.frame={id=0x7f0, bytes=8}",
    "links.1.frame={id=0x7f1, bytes=8}",
)
BEGIN, END = "<!-- cases -->\n", "<!-- end -->\n"
Path_ = tuple[FloatArray, FloatArray]


def of_presets(up: str, down: str = "") -> Path_:
    """Delays (n,), s, NaN: lost, of a network by name, there and back."""
    return _drawn(up, "there"), _drawn(down or up, "back")


def _drawn(name: str, way: str) -> FloatArray:
    law = delay_law({"law": "preset", "name": name}, Path())
    return _lost_as_nan(law.stream(PERIOD, generator(0, f"{name} {way}")).take(PACKETS))


def of_bus() -> Path_:
    """Delays of the two frames of xi on a bus with a load of 90 %."""
    links = assemble(load(BUS, list(LOADED))).links
    tables = [link.table for link in links if isinstance(link.table, DrawnTable)]
    there, back = (t.law.stream(PERIOD, generator(0, t.name)).take(PACKETS) for t in tables)
    return _lost_as_nan(there), _lost_as_nan(back)


def _lost_as_nan(delay: FloatArray) -> FloatArray:
    return np.where(np.isfinite(delay), delay, np.nan)


CASES: dict[str, tuple[Callable[[], Path_], str]] = {
    "LAN": (lambda: of_presets("lan"), "last-arrival"),
    "Wi-Fi at home": (lambda: of_presets("wifi5"), "newest-stamp"),
    "4G": (lambda: of_presets("lte-up", "lte-down"), "newest-stamp"),
    "geostationary satellite": (lambda: of_presets("geo"), "newest-stamp"),
    "classic CAN at 90 %": (of_bus, "last-arrival"),
}


def row(name: str, folder: Path) -> str:
    """A network: what was measured, and what follows."""
    delays, semantics = CASES[name][0](), CASES[name][1]
    trace = PathTrace(np.arange(PACKETS) * float(PERIOD), *delays, semantics)
    found = {n.label: n for n in predict(SCENARIO, trace).numbers}
    effort = next(n for label, n in found.items() if "effort" in label)
    settled = next(n for label, n in found.items() if "tracking" in label and n.unit == "s")
    alive = survivors(SCENARIO, variants_path(SCENARIO), trace, folder, jobs=2)
    failed = ", ".join(_failed(one) for one in alive if not one.stable) or "none"
    ways = " · ".join(_way(way_figures(d)) for d in delays)
    lost = " · ".join(f"{np.isnan(d).mean():.1%}" for d in delays)
    return (
        f"| {name} | {ways} | {lost} | {settled.value:.1f} ({settled.least:.1f} to "
        f"{settled.most:.1f}) | {effort.value:.1f} ({effort.least:.1f} to {effort.most:.1f}) "
        f"| {sum(one.stable for one in alive)} of {len(alive)} | {failed} |"
    )


def _failed(one: ControllerSurvival) -> str:
    hands = [operator for operator, said in one.verdicts.items() if said[:3] != "yes"]
    return f"`{one.name}` ({', '.join(hands)})"


def _way(f: WayFigures) -> str:
    return f"{1e3 * f.quantiles[0]:.3g} / {1e3 * f.quantiles[2]:.3g}"


def table() -> Iterator[str]:
    """The table, line by line."""
    yield (
        "| network | 50 % / 99 % there · back, ms | lost | `paper` settles, s | its effort, N·m·√s "
        "| laws that come to rest with every hand | those that do not |"
    )
    yield "|---|---|---|---|---|---|---|"
    for name in CASES:
        with TemporaryDirectory() as folder:
            yield row(name, Path(folder))


def main() -> None:
    """Replace the table in the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    tail = rest.split(END, 1)[1]
    PAGE.write_text(f"{head}{BEGIN}{chr(10).join(table())}\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
