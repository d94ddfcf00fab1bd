"""``report.html`` that computes its run again with other values, in the browser that shows it."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Mapping
from html import escape, unescape
from importlib.resources import files
from pathlib import Path
from typing import Any

from cosim.base.errors import CosimError
from cosim.base.units import printed_unit
from cosim.live.bundle import FORMAT
from cosim.live.judged import judged
from cosim.record import Run, seal
from cosim.record.folder import REPORT, SUMS
from cosim.reporting.arms import arm_signals, first_arms
from cosim.reporting.html import PageData, command, embedded, folded, table
from cosim.reporting.recorded import recorded_scenario
from cosim.reporting.run_report import CHOSEN, SHOWN, frame_times, write_report

#: Bytes of a page, at most.
MOST = 2_500_000
#: Groups of values that are open when the page is.
OPEN = 2
#: The keys of a value that the page needs; the others are for the engine.
_SHOWN = ("key", "label", "about", "unit", "value", "low", "high", "step", "choices", "group")


def write_live_report(run: Run, bundle: Mapping[str, Any], again: str, digest: str) -> Path:
    """Write the report of a run into its folder, with the scenario as a `bundle` in it.

    `again`: the command that repeats the run, to which settings can be added; `digest`: of the
    run. Raises CosimError if it cannot be written.
    """
    keys = [
        {name: key[name] for name in _SHOWN} | {"unit": printed_unit(key["unit"])}
        for key in bundle["keys"]
    ]
    keys.sort(key=lambda key: not key["key"].startswith("links."))
    links = dict.fromkeys(key["group"] for key in keys if key["key"].startswith("links."))
    facts: dict[str, Any] = {
        "command": again, "digest": digest, "keys": keys, "ordered": bundle["ordered"],
        "added": bundle["added"], "links": [*links], "open": OPEN,
    }  # fmt: skip

    def extend(data: PageData) -> str:
        data.computes = True
        return _NOTE + _data(run, data, facts, bundle)

    return write_report(run, extend=extend, first=_panel(again, bundle))


def write_if_live(
    run: Run, made: Callable[[], Mapping[str, Any]], again: str, digest: str
) -> tuple[Path, str]:
    """Write the report of a run, live if it can be and has at most :data:`MOST` bytes.

    The file, and the reason why it is not live, or "". `made` makes the bundle; the others are as
    in :func:`write_live_report`. An error there, also one of this program, costs no report. Raises
    CosimError if the report cannot be written.
    """
    try:
        path = write_live_report(run, made(), again, digest)
        size = path.stat().st_size
        if size <= MOST:
            return path, ""
        reason = (
            f"the page would have {size / 1e6:.2f} MB, expected at most {MOST / 1e6:.1f} MB: record"
            " fewer signals (--record) or fewer ticks (run.record.every)"
        )
    except CosimError as error:
        reason = str(error)
    except Exception as error:
        reason = f"an error of this program, {type(error).__name__}: {error}"
        warnings.warn(f"a report is not live: {reason}", RuntimeWarning, stacklevel=1)
    return _write_without(run, reason), reason


def _write_without(run: Run, reason: str) -> Path:
    """Write a report that cannot compute, with the reason."""
    text = f'<p class="arms" id="not-live">{_CANNOT}{escape(reason)}</p>'
    return write_report(run, extend=lambda data: text)


_CANNOT = "This report cannot compute: "


def _panel(again: str, bundle: Mapping[str, Any]) -> str:
    """The part of the page in which values are moved; hidden until a script can run them."""
    fixed = [(entry["key"], entry["reason"]) for entry in bundle["fixed"]]
    why = folded("What cannot be moved, and why", table(["value", "reason"], fixed))
    return f"""<section id="live" aria-labelledby="live-title" hidden><style>{asset("live.css")}
</style><h2 id="live-title">Try other values</h2>
<p>Move a value: this page computes the whole run again, with the bits of <code>cosim run</code>.
Pale curves are the recorded run.</p><p class="choices" id="live-choices"></p>
<div id="live-values"></div>
<p><button id="live-reset">Reset</button> <span id="live-verdict"></span>
<output id="live-said" role="status"></output></p>
{command("live-command", again)}
<p class="digest">SHA-256 of its signals: <code id="live-digest"></code>
<span id="live-recorded"></span></p>{why if fixed else ""}</section>"""


_NOTE = """<p id="live-note" hidden>What follows is of the recorded run, except “Results”.</p>"""


def _data(run: Run, data: PageData, facts: Mapping[str, Any], bundle: Mapping[str, Any]) -> str:
    """The data of the scripts of the page, and the scripts."""
    scenario, times = recorded_scenario(run), frame_times(data)
    units = {name: unit for name, unit in run.units.items() if name != "t"}
    end = bundle["start"] + bundle["ticks"] * bundle["h"]
    panels = {name for panel in data.panels for name, _ in panel.series}
    page = {
        "judged": judged(scenario, run, units, end),
        "curves": {
            name: SHOWN if name in panels else CHOSEN for name in data.signals if name in units
        },
        "arms": {
            "names": [arm_signals(run, arm) for arm in first_arms(run)[0]],
            "begin": data.begin, "frame": data.frame, "count": len(times),
        },
    }  # fmt: skip
    return scripts({**facts, "page": page}, bundle, "worker", "live")


def scripts(facts: Any, bundle: Any, worker: str, own: str) -> str:
    """The data and the scripts of a live page.

    `facts`, `bundle`: what the page and its worker read, as JSON has it; `worker`, `own`: the names
    of their scripts.
    """
    documents = {"live-data": facts, "bundle": bundle}
    parts = [
        f'<script type="application/json" id="{name}">{embedded(data)}</script>'
        for name, data in documents.items()
    ]
    parts += [
        f'<script type="text/plain" id="live-{name}">{asset(f"{name}.js")}</script>'
        for name in ("engine", "measure", worker)
    ]
    parts.append(f'<script type="module">{asset("controls.js")}\n{asset(f"{own}.js")}</script>')
    return "".join(parts)


def asset(name: str) -> str:
    """The text of a script or style of live pages, as it may stand inside an element."""
    text = (files("cosim.live") / "assets" / name).read_text(encoding="utf-8")
    return text.replace("</script", "<\\/script")


def rewrite_live(run: Run) -> Path | None:
    """Write a live report again, with the simulator that it contains, or the reason for none.

    None: the report of the folder has neither.

    Raises CosimError if it cannot be written.
    """
    try:
        text = (run.path.parent / REPORT).read_text(encoding="utf-8")
    except OSError:
        return None
    without = re.search(rf'<p class="arms" id="not-live">{_CANNOT}(.*?)</p>', text, re.DOTALL)
    if without is not None:
        return _sealed(_write_without(run, unescape(without[1])))
    facts, made = (_embedded(text, name) for name in ("live-data", "bundle"))
    if facts is None or made is None or made["format"] != FORMAT:
        return None
    return _sealed(write_live_report(run, made, facts["command"], facts["digest"]))


def _sealed(report: Path) -> Path:
    """A report, after its sum was written again if the folder has sums."""
    if (report.parent / SUMS).exists():
        seal(report.parent, changed=[report.name])
    return report


def _embedded(text: str, name: str) -> dict[str, Any] | None:
    """A document in a page, by the name of its element."""
    pattern = rf'<script type="application/json" id="{name}">(.*?)</script>'
    found = re.search(pattern, text, re.DOTALL)
    return None if found is None else dict(json.loads(found[1]))
