"""More reports of users of other tools, each tried here: the right value stays.

The reports are public: OpenModelica 16354; lerobot 3178; zenoh-python 540; zenoh 1738; dimos 2982.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

import cosim
from bridge.can.messages import BusMessage
from bridge.ping.watch import PingAlarm, PingWatch
from bridge.preflight.bus_checks import check_buses
from cosim.base.copies import replace
from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat, frame_bits, worst
from cosim.bus.traffic import PeriodicSource, merged
from cosim.record import Run
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.ping.test_watch import FakePath
from tests.cosim.fmi.exporter import export
from tests.system.test_public_reports import ran


def derived(folder: Path) -> Path:
    """An FMU whose state and calculated parameter follow from its parameter `par`."""

    def scalar(name: str, reference: int, causality: str, more: str, inside: str) -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f"{more}><Real {inside}/></ScalarVariable>"
        )

    variables = (
        scalar("par", 0, "parameter", 'variability="fixed"', 'start="1"'),
        scalar("twice", 1, "calculatedParameter", 'variability="fixed" initial="calculated"', ""),
        scalar("x", 2, "local", 'initial="calculated"', ""),
        scalar("der(x)", 3, "local", "", 'derivative="3"'),
        scalar("y", 4, "output", "", ""),
    )
    text = (
        '<fmiModelDescription fmiVersion="2.0" modelName="derived" guid="t" '
        'numberOfEventIndicators="0"><ModelExchange modelIdentifier="derived2"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables><ModelStructure><Outputs>"
        '<Unknown index="5"/></Outputs><Derivatives><Unknown index="4"/></Derivatives>'
        '<InitialUnknowns><Unknown index="2"/><Unknown index="3"/></InitialUnknowns>'
        "</ModelStructure></fmiModelDescription>"
    )
    return export(text, folder / "derived.fmu")


@pytest.mark.parametrize(("given", "par"), [((), 1.0), (("--set", "par=5"), 5.0)])
def test_what_is_calculated_of_a_parameter_follows_the_value_that_is_set(
    tmp_path: Path, given: tuple[str, ...], par: float
) -> None:
    """As FMPy has it: the state starts at the new value, and 2 par is twice that."""
    path = derived(tmp_path)
    done = ran(path, "--stop", "1", "--record", "all", *given)
    assert done.exit_code == 0, done.output
    run = Run.open(tmp_path / "run")
    assert run.column("derived2.twice").tolist() == [2 * par] * len(run)
    theirs = fmpy.simulate_fmu(
        str(path), start_values={"par": par}, stop_time=1.0, output=["x", "twice"]
    )
    assert theirs["x"][0] == run.column("derived2.x")[0] == par
    assert (theirs["twice"] == 2 * par).all()
    assert run.column("derived2.x")[-1] == pytest.approx(par * np.exp(-1.0), rel=1e-3)


def test_a_frame_that_keeps_the_nominal_bit_rate_is_named_and_takes_its_time() -> None:
    """48 bytes at 1 and 5 Mbit/s: all bits behind the switch take five times as long."""
    timing = BusTiming(1e6, 5e6, fd=True)
    common: dict[str, Any] = {"length": 48, "period": 0.005, "bus": "b", "fd": True}
    messages = [
        BusMessage(name="A", identifier=0x100, node="a", brs=True, **common),
        BusMessage(name="B", identifier=0x101, node="b", **common),
    ]
    found = check_buses(messages, {"b": timing})
    (said,) = (f for f in found if f.rule == "rate-switch")
    assert (said.severity, said.where) == ("warning", "B (0x101)")
    slow, fast = (worst(48, FrameFormat(fd=True, brs=brs)) for brs in (False, True))
    assert said.number == pytest.approx((slow.nominal + slow.data) * 1e-6)
    assert slow.nominal + slow.data == fast.nominal + fast.data
    everybody = [replace(m, brs=True) for m in messages]
    assert not [f for f in check_buses(everybody, {"b": timing}) if f.rule == "rate-switch"]
    assert not [f for f in check_buses(messages, {"b": BusTiming(1e6, fd=True)})
                if f.rule == "rate-switch"]  # fmt: skip

    frames = [BusFrame(0x100, bytes(48), FrameFormat(fd=True, brs=n == 0)) for n in (0, 1)]
    took = []
    for frame in frames:
        bus = SimulatedBus(timing, [BusNodeSettings("a"), BusNodeSettings("b")])
        bus.request_many(merged([PeriodicSource(0, frame, 10**12)], 0, 10**9))
        events = bus.advance(10**9)
        (end,) = events["time"][events["kind"] == BusEvent.SENT]
        took.append(int(end))
    bits = [frame_bits(f.identifier, f.data, f.format) for f in frames]
    # what differs is the rate of the data bits, and of the bit that tells of the switch
    assert took[1] - took[0] == pytest.approx(bits[0].data * (1e6 - 2e5), abs=2e5)


def test_a_path_that_is_late_after_twenty_minutes_is_late_from_then_on() -> None:
    """Twenty minutes at 20 Hz: quiet windows are quiet, and the alarm begins where 1 s is added."""
    period = 50_000_000
    path = FakePath(capacity=30_000, period_ns=period)
    file, said = io.StringIO(), []
    with PingWatch(60.0, period, [PingAlarm.parse("max > 100 ms")], file, said.append) as watch:
        path.ask(19 * 60 * 20, delay=5e-3)
        path.ask(60 * 20, delay=0.5)
        watch.finish(path.record)
    windows = [json.loads(line) for line in file.getvalue().splitlines()]
    assert [w["alarms"] for w in windows] == [[]] * 19 + [["max > 100 ms"]]
    longest = [w["figures"]["delays"]["round trip"]["max"] for w in windows]
    assert max(longest[:-1]) < 0.1 and longest[-1] > 0.9


def test_two_arms_over_published_round_trips_in_a_tight_grip(tmp_path: Path) -> None:
    """15, 114, 134 and 160 ms: laws with a condition that holds are stable at each, one beyond its
    passive limit at none, and what has no condition comes together later the later it hears.
    """
    links = {
        f"rtt-{ms}": {"title": f"{ms} ms", "delay": {"law": "constant", "delay": f"{ms / 2} ms"}}
        for ms in (15, 114, 134, 160)
    }
    bilateral = TELEOPERATION.parent / "compare" / "bilateral.toml"
    inside = "\n".join(
        f'{name} = {{ title = "{x["title"]}", delay = {{ law = "constant", delay = '
        f'"{x["delay"]["delay"]}" }} }}' for name, x in links.items()
    )  # fmt: skip
    variants = tmp_path / "published.toml"
    variants.write_text(f'extends = "{bilateral}"\ntitle = "Published"\n[links]\n{inside}\n')
    laws = ("paper", "paper-1", "p+d", "tdpa-drift")
    found = cosim.compare(
        TELEOPERATION, controllers=laws, operators=["tight"], links=list(links),
        variants=variants, set={"run.stop": "40 s"},
    )  # fmt: skip
    by_law = {law: [o for o in found.outcomes if o.case.controller == law] for law in laws}
    stable = {law: [o.verdict.stable for o in of] for law, of in by_law.items()}
    assert stable == {"paper": [False] * 4, **{law: [True] * 4 for law in laws[1:]}}
    apart = [o.numbers["synchronised"][0] for o in by_law["tdpa-drift"]]
    late = [np.inf if np.isnan(x) else x for x in apart]
    assert late == sorted(late) and late[0] < 10.0 < late[1]
