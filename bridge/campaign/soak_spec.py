"""Distributions of faults and invariants of each run of a soak test: ``soak.toml``.

::

    settings = ["run.step='5 ms'"]      # of every run
    faults = [1, 4]                     # how many at once
    first = "2 s"                       # none begins earlier
    last = "9 s"                        # all are over by then
    settle = "8 s"                      # after which the arms have to be together
    together = { metric = "sync_error", within = 0.1 }
    torque_max = "100 N.m"              # of every controller, at any time
    [kinds.drop]
    for = ["0.5 s", "3 s"]              # drawn between the two, as all pairs are
    probability = [0.2, 0.6]

A kind may have the keys it has in a fault script (docs/faults.md) except whom it is for, which is
drawn too, and `weight`, by which it is chosen.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from bridge.campaign.drive_draw import draw_drive_fault, drives_of
from bridge.deployment.system import System
from bridge.faults.script import HOSTILE
from bridge.faults.spec import SPECS
from cosim.base import toml
from cosim.base.convert import Quantity, convert, in_units, number
from cosim.base.errors import ScenarioError

#: Kinds a soak can draw, and what it says itself of each.
FRAMES = ("drop", "burst", "corrupt", "duplicate", "reorder", "delay", "jitter")
PROCESSES = ("restart", "freeze")
#: Kinds that only a campaign of many faults draws.
OTHERS = ("sync-loss", "kill", "clock-jump")
#: Of emulated drives; :mod:`bridge.campaign.drive_draw` draws what a drive does, and for how long.
DRIVE = "drive"
LINKS = ("net-down", "net-delay", "net-loss", "net-rate")
_DRAWN = {"kind", "node", "message", "bus", "link", "at", "from", "to"}
_UNITS = {"probability": "1", "burst": "1", "weight": "1", "rate": "bit/s"}
#: Where a soak's file is looked for: beside the scenario.
DEFAULT = Path("faults") / "soak.toml"

Value = float | bool | tuple[float, float]


class TogetherSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A metric of the scenario (kind ``error``), and its limit at the end of a run."""

    metric: str
    within: Quantity

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, within="1")


class SoakSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A soak test as read from its file; see the module. Times in s, torques in N.m.

    `zenoh`: configurations between hosts, paths relative to the file.
    """

    title: str = ""
    settings: tuple[str, ...] = ()
    zenoh: str | tuple[str, ...] = ()
    faults: tuple[int, int] = (1, 3)
    first: Quantity
    last: Quantity
    settle: Quantity = 0.0
    together: TogetherSpec | None = None
    torque_max: Quantity
    kinds: dict[str, dict[str, Any]]

    def __post_init__(self) -> None:
        """Convert what has a unit. Raises ScenarioError."""
        in_units(self, first="s", last="s", settle="s", torque_max="N.m")


class Soak(msgspec.Struct, frozen=True):
    """A soak test and its file; `kinds`: what is drawn for each, by key."""

    path: Path
    spec: SoakSpec
    kinds: dict[str, dict[str, Value]]

    def zenoh(self, seed: int, k: int) -> str:
        """The configuration between hosts in run `k`; "": the deployment's own."""
        given = self.spec.zenoh
        files = (given,) if isinstance(given, str) else given
        if not files:
            return ""
        return str(self.path.parent / files[np.random.default_rng((seed, k, 1)).choice(len(files))])


def load_soak(scenario: str | Path, given: str | Path | None) -> Soak:
    """The file `given`, or that next to the scenario. Raises ScenarioError with file and place."""
    path = Path(given) if given else Path(scenario).parent / DEFAULT
    spec = convert(toml.read(Path(path)), SoakSpec, path, "")
    if not 0 < spec.faults[0] <= spec.faults[1]:
        raise ScenarioError(f"is {list(spec.faults)}; expected [least, most]", f"{path} at faults")
    kinds = {kind: kind_of(kind, table, path) for kind, table in spec.kinds.items()}
    if not kinds:
        raise ScenarioError("no [kinds.NAME] table", f"{path}")
    return Soak(path, spec, kinds)


def kind_of(kind: str, table: dict[str, Any], path: Path) -> dict[str, Value]:
    """The values that are drawn for a kind, by key. Raises ScenarioError with file and place."""
    known = (*FRAMES, *HOSTILE, *PROCESSES, *OTHERS, *LINKS, DRIVE)
    if kind not in known:
        raise ScenarioError(
            f"unknown kind {kind!r}; expected one of {', '.join(known)}", f"{path} at kinds"
        )
    own = () if kind == DRIVE else (*SPECS[kind].__struct_encode_fields__, "for")
    keys = sorted({*own, "weight"} - _DRAWN)
    found: dict[str, Value] = {}
    for key, value in table.items():
        place = f"{path} at kinds.{kind}.{key}"
        if key not in keys:
            raise ScenarioError(f"unknown key; expected one of {', '.join(keys)}", place)
        found[key] = _value(value, _unit(kind, key), place)
    if "for" not in found and kind not in (*OTHERS, DRIVE):
        raise ScenarioError("no for", f"{path} at kinds.{kind}")
    return found


def _unit(kind: str, key: str) -> str:
    if key == "by" and kind in HOSTILE:
        return "1"
    if key == "rate" and kind in HOSTILE:
        return "1/s"
    return _UNITS.get(key, "s" if key != "count" else "1")


def _value(value: Any, unit: str, place: str) -> Value:
    if isinstance(value, bool):
        return value
    if not isinstance(value, list):
        return number(value, unit, place)
    if len(value) != 2:
        raise ScenarioError(f"found {len(value)} values; expected [least, greatest]", place)
    low, high = (number(v, unit, place) for v in value)
    if low > high:
        raise ScenarioError(f"is {low:g} to {high:g}; expected [least, greatest]", place)
    return low, high


# ---- drawing --------------------------------------------------------------------------------

Table = dict[str, Any]


def draw(soak: Soak, system: System, links: tuple[str, ...], seed: int, k: int) -> Table:
    """The fault script of run `k`: a document as :func:`bridge.faults.load.build` reads it.

    `links`: between hosts, ``FROM>TO``; none: no faults of the network.
    """
    random = np.random.default_rng((seed, k))
    kinds = [kind for kind in soak.kinds if links or kind not in LINKS]
    drives = drives_of(system)
    kinds = [kind for kind in kinds if drives or kind != DRIVE]
    weights = np.array([float(_one(soak.kinds[kind].get("weight", 1.0))) for kind in kinds])
    wanted = int(random.integers(soak.spec.faults[0], soak.spec.faults[1] + 1))
    tables: list[Table] = []
    for _ in range(50 * wanted):
        if len(tables) == wanted:
            break
        kind = kinds[int(random.choice(len(kinds), p=weights / weights.sum()))]
        if kind == DRIVE:
            table = draw_drive_fault(drives, random, soak.spec.first, soak.spec.last)
        else:
            table = _table(soak, kind, system, links, random)
        if all(_agree(table, other) and _agree(other, table) for other in tables):
            tables.append(table)
    return {"title": f"run {k} of seed {seed}", "seed": seed * 100_003 + k, "fault": tables}


def _one(value: Value) -> float:
    return value[0] if isinstance(value, tuple) else float(value)


def _table(
    soak: Soak, kind: str, system: System, links: tuple[str, ...], random: np.random.Generator
) -> Table:
    """One fault: to whom, when and how strong."""
    drawn: Table = {}
    for key, value in soak.kinds[kind].items():
        if key == "by" and isinstance(value, tuple):
            drawn[key] = sorted(round_duration(random.uniform(*value)) for _ in range(2))
        elif key != "weight":
            drawn[key] = random.uniform(*value) if isinstance(value, tuple) else value
    if "count" in drawn:
        drawn["count"] = round(drawn["count"])
    lasts = round_duration(min(drawn.pop("for"), soak.spec.last - soak.spec.first))
    t = round_duration(random.uniform(soak.spec.first, soak.spec.last - lasts))
    whom = {"link": str(random.choice(["*", *links]))} if kind in LINKS else {}
    if not whom:
        whom["node"] = str(random.choice([n for n in system.nodes if system.received_by(n)]))
    if kind in (*FRAMES, *HOSTILE):
        whom["message"] = str(random.choice(system.received_by(whom["node"])))
        when = {"from": t, "to": round_duration(t + lasts)}
    else:
        when = {"at": t, "for": lasts}
    rest = {key: round_duration(v) if isinstance(v, float) else v for key, v in drawn.items()}
    return {"kind": kind, **whom, **when, **rest}


def round_duration(value: float) -> float:
    """To 0.1 ms, as it is written down."""
    return round(value, 4)


def _agree(a: Table, b: Table) -> bool:
    """True if the effects of both faults can be distinguished in the results.

    Counters are lost with a node that is killed; a duplicated frame may be corrupted once; of two
    faults of a link, one would hide the other. A drive that begins again with its node forgets what
    has happened to it.
    """
    if a["kind"] == DRIVE:
        return b["kind"] not in (DRIVE, "restart")
    node = a.get("node", a.get("link")) == b.get("node", b.get("link"))
    if a["kind"] in PROCESSES and node:
        return a["kind"] == "freeze" and b["kind"] in FRAMES
    if a["kind"] == "corrupt" and b["kind"] == "duplicate":
        return not node
    return a["kind"] not in LINKS or a["kind"] != b["kind"]


def text(document: Table) -> str:
    """A document as TOML, to be read again and used by hand."""
    lines = [f"{key} = {json.dumps(document[key])}" for key in ("title", "seed")]
    for table in document["fault"]:
        lines += ["", "[[fault]]", *(f"{key} = {json.dumps(v)}" for key, v in table.items())]
    return "\n".join(lines) + "\n"
