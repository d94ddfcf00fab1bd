"""Reports of users of other tools, each tried here: the right value stays.

Each test names what was reported, in our words. The reports are public: OpenModelica 8630, 16354;
FMPy 692; OSP's demonstrations 55; OMSimulator 1280, 1550; cantools 300; zephyr 49863;
python-can-isotp 142; python-can 1732; PlotJuggler 344.
"""

from __future__ import annotations

import json
from pathlib import Path
from time import process_time

import can
import numpy as np
import pytest
from click.testing import Result
from mcap.reader import make_reader
from typer.testing import CliRunner

from cosim.base.component import Port
from cosim.base.errors import CosimError
from cosim.bus.arbitration import rank
from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.response import FrameStream, responses
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming
from cosim.bus.traffic import PeriodicSource, babbling, merged
from cosim.cli.commands import app
from cosim.record import Run
from tests.cosim.algorithms.networks import column, record
from tests.cosim.fmi import plain
from tests.cosim.fmi.exporter import exchange2, exchange3, export
from tests.cosim.scenarios import plan
from tests.ssp.parts import bindings, embedded, pack, ssd

HERE = __name__
COUNTS = 4.0


class Ramp:
    """Continuous: y = t."""

    kind = "continuous"
    inputs = ()
    outputs = (Port("y"),)
    parameters = ()

    def initialize(self, values):
        del values

    def initial(self, u):
        return {"y": 0.0}

    def step(self, t, h, u):
        return {"y": t + h}

    def get_state(self):
        return None

    def set_state(self, state):
        del state


class Trip(Ramp):
    """Continuous: the time at which its input was first seen above 2.5."""

    inputs = (Port("u"),)
    outputs = (Port("at"),)

    def initialize(self, values):
        self.at = -1.0

    def initial(self, u):
        return {"at": self.at}

    def step(self, t, h, u):
        if self.at < 0 and u["u"] > 2.5:
            self.at = t
        return {"at": self.at}


class Mass(Ramp):
    """Continuous: a mass of 1 kg under a force, exactly integrated."""

    inputs = (Port("f", (), "N"),)
    outputs = (Port("x", (), "m"), Port("v", (), "m/s"))

    def initialize(self, values):
        self.x, self.v = 1.0, 0.0

    def initial(self, u):
        return {"x": self.x, "v": self.v}

    def step(self, t, h, u):
        self.x += h * self.v + h * h * float(u["f"]) / 2
        self.v += h * float(u["f"])
        return self.initial(u)

    def get_state(self):
        return self.x, self.v

    def set_state(self, state):
        self.x, self.v = state


class Damper(Ramp):
    """Continuous: a weak spring and a strong damper, f = -x - 50 v."""

    inputs = (Port("x", (), "m"), Port("v", (), "m/s"))
    outputs = (Port("f", (), "N"),)

    def initial(self, u):
        return {"f": -float(u["x"]) - 50.0 * float(u["v"])}

    def step(self, t, h, u):
        return self.initial(u)


@pytest.mark.parametrize("algorithm", ["sampled", "jacobi", "gauss-seidel"])
def test_a_line_trips_a_threshold_where_it_is_and_not_a_step_early(algorithm: str) -> None:
    """An input y = t passes 2.5 inside of a step of 1 s: never known at 2 s."""
    components = {
        "a": {"model": f"{HERE}:Ramp"},
        "b": {"model": f"{HERE}:Trip", "inputs": {"u": "a.y"}, "extrapolate": "linear"},
    }
    p = plan(components, algorithm=algorithm, step=1.0, stop=6.0)
    assert column(p, record(p), "b.at")[-1] == 3.0


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("late", [0.0, 1e-9])
def test_a_time_event_and_an_event_of_the_scenario_at_one_instant(
    tmp_path: Path, fmi: str, late: float
) -> None:
    """Both have happened in the row after 1 s, and no row depends on which was a little later."""
    model = export(exchange2() if fmi == "2.0" else exchange3(), tmp_path / "counts.fmu")
    path = tmp_path / "events.toml"
    path.write_text(f"""
[run]
step = 0.25
stop = 2.0
[components.x]
model = "{model}"
parameters = {{ model = {COUNTS}, period = {1.0 + late} }}
[[events]]
at = 1.0
set = {{ "x.gear" = 2 }}
""")
    out = tmp_path / "run"
    done = CliRunner().invoke(app, ["run", str(path), "--out", str(out), "--no-plot", "--quiet"])
    assert done.exit_code == 0, done.output
    run = Run.open(out)
    events, heard = run.array("x.events"), run.array("x.heard")
    assert events[run.t < 1.0 - 1e-9].max() == 0
    assert events[run.t > 1.2].min() == 1
    assert heard[run.t > 1.2].min() == heard.max() == 2


def test_a_strong_damper_over_wires_is_stable_below_its_limit_and_warned_of_above() -> None:
    """Mass and damper in two components, each a step late: above h c/m = 1, x grows for ever."""
    components = {
        "m": {"model": f"{HERE}:Mass", "inputs": {"f": "d.f"}},
        "d": {"model": f"{HERE}:Damper", "inputs": {"x": "m.x", "v": "m.v"}},
    }
    for step, stable in ((0.1, False), (0.01, True), (0.001, True)):
        p = plan(components, step=step, stop=3.0)
        assert bool(np.abs(column(p, record(p), "m.x")).max() < 1.01) is stable


def test_ten_thousand_error_frames_do_not_hold_back_the_good_one() -> None:
    """Nobody acknowledges, so each attempt is an error; who joins is heard at once and in order."""
    options = {"interface": "cosim", "bitrate": 1_000_000, "speed": "simulated"}
    with can.Bus("ten thousand errors", bus_errors=True, **options) as alone:
        alone.send(can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False))
        alone.sleep(1.7)
        begin, last, errors = process_time(), 0.0, 0
        with can.Bus("ten thousand errors", **options) as joined:
            joined.send(can.Message(arbitration_id=0x321, data=b"good", is_extended_id=False))
            while True:
                message = alone.recv(1.0)
                assert message is not None
                assert message.timestamp >= last
                last = message.timestamp
                if not message.is_error_frame:
                    break
                errors += 1
        assert bytes(message.data) == b"good"
        assert errors > 10_000
        assert process_time() - begin < 10.0  # it had been minutes


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_a_babbling_node_starves_all_others_or_delays_them_within_the_analysis(
    share: float,
) -> None:
    """Identifier 0 takes all of the bus, or 80 %: then no response is beyond the computed one."""
    timing, ms, end = BusTiming(500e3), 10**9, 200 * 10**9
    others = [BusFrame(identifier, bytes(8)) for identifier in (0x100, 0x200)]
    sources = [
        babbling(2, BusFrame(0, b"\x55" * 8), timing, share=share),
        *(PeriodicSource(i, frame, 20 * ms, offset_ps=ms) for i, frame in enumerate(others)),
    ]
    bus = SimulatedBus(timing, [BusNodeSettings(f"n{i}") for i in range(3)])
    requests = merged(sources, 0, end)
    bus.request_many(requests)
    events = bus.advance(end)
    sent = events[(events["kind"] == BusEvent.SENT) & (events["node"] < 2)]
    if share == 1.0:
        assert len(sent) == 0
        return
    bits = 135 * 2000  # the longest frame of 8 bytes and its interframe space, ns
    streams = [FrameStream("b", rank(0), int(sources[0].period_ps // 1000), bits)]
    streams += [FrameStream(f"{i}", rank(0x100 * (i + 1)), 20_000_000, bits) for i in (0, 1)]
    worst = {r.stream.name: r.worst for r in responses(streams, 2000)}
    for node in (0, 1):
        asked = ms + 20 * ms * np.arange(10)
        took = sent["time"][sent["node"] == node] - asked[: (sent["node"] == node).sum()]
        assert len(took) >= 9
        bound = worst[str(node)]
        assert bound is None or took.max() <= 1000 * bound


@pytest.mark.parametrize("groups", [1, 3])
def test_messages_of_a_periodic_group_keep_order_and_time(groups: int) -> None:
    """`send_periodic` of two messages: in turn, one each period, without drift in ten minutes."""
    name = f"groups {groups}"
    options = {"interface": "cosim", "bitrate": 500_000, "speed": "simulated"}
    with can.Bus(name, **options) as sender, can.Bus(name, **options) as receiver:
        for g in range(groups):
            pair = [can.Message(arbitration_id=0x100 + g, data=bytes([g, i]),
                                is_extended_id=False) for i in (0, 1)]  # fmt: skip
            sender.send_periodic(pair, 1.0)
        heard: dict[int, list[tuple[float, int]]] = {g: [] for g in range(groups)}
        while True:
            message = receiver.recv(2.0)
            if message is None or message.timestamp > 600.0:
                break
            group, which = message.data
            heard[group].append((message.timestamp, which))
    for found in heard.values():
        assert [which for _, which in found] == [i % 2 for i in range(len(found))]
        times = np.array([t for t, _ in found])
        assert len(times) >= 600
        assert times - times[0] == pytest.approx(np.arange(len(times)), abs=1e-3)


def system(folder: Path, parameters: dict[str, str]) -> Path:
    """An SSP of one FMU, y = u + p, whose `k` is a constant; the outer system sets values of it."""
    constant = (
        '<ScalarVariable name="k" valueReference="17" causality="output" variability="constant">'
        '<Real start="7"/></ScalarVariable>'
    )
    variables = [
        plain.real("u", plain.U, "input"), plain.real("p", plain.P, "parameter", "1"), constant,
        plain.real("y", plain.Y, "output"),
    ]  # fmt: skip
    fmu = plain.export(folder / "plain.fmu", plain.described(variables))
    kind = 'type="application/x-fmu-sharedlibrary" source="resources/plain.fmu"'
    inside = f'<ssd:Component name="x" {kind}/>'
    given = bindings(embedded({f"x.{k}": v for k, v in parameters.items()}))
    text = ssd(f"{given}<ssd:Elements>{inside}</ssd:Elements>")
    return pack(folder / "system.ssp", text, fmus={"resources/plain.fmu": fmu})


def ran(path: Path, *more: str) -> Result:
    return CliRunner().invoke(
        app, ["run", str(path), "--set", "run.step=0.1", "--out", str(path.parent / "run"),
              "--no-plot", *more],
    )  # fmt: skip


def test_a_parameter_set_with_a_constant_is_refused_by_its_name(tmp_path: Path) -> None:
    done = ran(system(tmp_path, {"k": "5"}))
    assert isinstance(done.exception, CosimError)
    assert "components.x.parameters.k" in str(done.exception)


def test_a_value_that_is_set_wins_over_the_set_of_the_outer_system(tmp_path: Path) -> None:
    path = system(tmp_path, {"p": "3"})
    for more, expected in (((), 3.0), (("--set", "components.x.parameters.p=9"), 9.0)):
        done = ran(path, "--force", *more)
        assert done.exit_code == 0, done.output
        assert Run.open(tmp_path / "run").array("x.y")[-1] == expected


def test_an_exported_recording_has_one_clock(tmp_path: Path) -> None:
    """What a link of 0.7 s delivers is 0.7 s behind what was sent, and no stamp differs from its
    time in the file.
    """
    pytest.importorskip("foxglove")
    scenario = Path(__file__).parents[2] / "configs" / "teleoperation.toml"
    out = tmp_path / "run"
    delays = [f'links.{i}.delay={{law="constant", delay=0.7}}' for i in (0, 1)]
    settings = ["run.stop=2.0", 'run.record.signals=["*"]', *delays]
    more = [word for setting in settings for word in ("--set", setting)]
    arguments = ["run", str(scenario), "--out", str(out), "--no-plot", "--quiet", *more]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, (done.output, done.exception)
    done = CliRunner().invoke(app, ["export", str(out), "--to", str(tmp_path / "a.mcap")])
    assert done.exit_code == 0, (done.output, done.exception)
    sent: dict[int, list[float]] = {}
    got: dict[int, list[float]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding != "json":
                continue
            data = json.loads(message.data)
            if channel.topic == "/master_control":
                sent[message.log_time] = data["xi"]
            elif channel.topic == "/slave_control":
                got[message.log_time] = data["xi_in"]
    late = 700_000_000
    del got[max(got)]  # of the end itself: controllers have not computed there
    times = [t for t in got if t - late in sent]
    assert len(times) > 100
    for t in times:
        assert np.ravel(got[t]) == pytest.approx(sent[t - late], abs=1e-12)
