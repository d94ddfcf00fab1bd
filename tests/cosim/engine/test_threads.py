"""Threads that share the ticks of many FMUs: the same bytes, and the same failures."""

import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from benchmarks.cases import rings
from cosim.base.errors import RunError
from cosim.engine import binding, threads
from cosim.engine.arrays import rows_of, stretches
from cosim.engine.engine import Engine
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load, read_document
from cosim.native import structs
from cosim.native.enums import Code
from cosim.scenario.arrays import expand
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.partition import partition
from cosim.schedule.plan import Plan, compile_plan
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.fmi.exporter import export, strict2, strict3
from tests.cosim.scenarios import plan

TICKS = 1500


@pytest.fixture(autouse=True)
def few_parts(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run parts apart however few they are."""
    monkeypatch.setattr(binding, "LEAST", 2)
    yield
    left = [t for t in threading.enumerate() if t.name.startswith(threads.NAME)]
    assert not left  # they end with the engine


def recorded(
    p: Plan, threads: int, ticks: int = TICKS, columns: list[int] | None = None
) -> tuple[bytes, list[int]]:
    """What is recorded at all ticks, in calls of different length; the windows' lengths."""
    width = p.n_signals if columns is None else len(columns)
    rows, windows = np.empty((ticks, width)), []
    with Engine(p, threads=threads, columns=columns) as engine:
        engine.initialize()
        for first in range(0, ticks, 700):
            n = min(700, ticks - first)
            assert engine.run(n, rows[first : first + n]) == n
            windows.append(engine._team.window if engine._team else 0)
    return rows.tobytes(), windows


def many(*changes: str) -> Plan:
    return assemble(load(CONFIGS / "many.toml", ("graphs.net.n=12", "run.stop=2", *changes)))


@settings(max_examples=12)
@given(
    threads=st.integers(2, 6), n=st.integers(3, 20), seed=st.integers(0, 3),
    least=st.integers(5, 80),
)  # fmt: skip
def test_any_number_of_threads_and_any_delay_give_the_same_bytes(
    threads: int, n: int, seed: int, least: int
) -> None:
    changes = (f"graphs.net.n={n}", 'graphs.net.kind="ring"', f"run.seed={seed}")
    changes += (f'links.0.delay.low="{least} ms"',)
    alone, none = recorded(many(*changes), 1)
    together, windows = recorded(many(*changes), threads)
    assert together == alone
    assert min(windows) >= min(least // 5 * 5, binding.WINDOW) and not any(none)


def test_one_thread_runs_many_parts_apart_with_the_same_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, none = recorded(many(), 1)
    monkeypatch.setattr(binding, "ALONE", 2)
    apart, windows = recorded(many(), 1)
    assert apart == whole
    assert min(windows) >= 30 and not any(none)


def test_a_row_has_the_columns_that_are_asked_for() -> None:
    p = many()
    columns = [p.n_signals - 1, 3, 4, 5, 17, 16, 0]
    rows = np.frombuffer(recorded(p, 1)[0]).reshape(TICKS, -1)
    for number in (1, 2):
        some = np.frombuffer(recorded(many(), number, columns=columns)[0]).reshape(TICKS, -1)
        assert np.array_equal(some, rows[:, columns])


@pytest.mark.parametrize("config", ["network", "teleoperation"])
def test_shipped_scenarios_give_the_same_bytes(config: str) -> None:
    def made() -> Plan:
        return assemble(load(CONFIGS / f"{config}.toml", ("run.stop=2",)))

    assert recorded(made(), 3)[0] == recorded(made(), 1)[0]


@pytest.mark.parametrize("choice", ["fmi2", "fmi3"])
def test_fmus_that_wires_connect_are_shared_in_two_stages(choice: str) -> None:
    alone, _ = recorded(rings(40, TICKS).plan(choice, TICKS), 1)  # type: ignore[arg-type]
    together, windows = recorded(rings(40, TICKS).plan(choice, TICKS), 2)  # type: ignore[arg-type]
    assert together == alone and all(windows)


def test_what_a_part_uses_is_known_once_each() -> None:
    """Operations, units, links and senders, signals and FMUs of a part are in its spans."""
    with Engine(many(), threads=2) as engine:
        engine.initialize()
        bound = engine.bound
        assert bound.divided is not None and bound.partition is not None
        part_of, (part, place) = bound.partition.part_of, bound.partition.operations
        n_plan = len(bound.plan.operations)
        operations = bound.operations[n_plan:]
        assert [bound.plan.operations[i].code for i in place] == operations["code"].tolist()
        units, links = rows_of(bound.units), rows_of(bound.links)
        for number, x in enumerate(bound.divided.parts):
            kind = structs.SpanStruct * int(x["n_spans"])
            spans = [(s.first, s.first + s.size) for s in kind.from_address(int(x["spans"]))]
            assert all(a[1] < b[0] for a, b in pairwise(spans))
            own = operations[part == number]
            mine = [units[i : i + 1] for i in np.flatnonzero(part_of == number)]
            received = links[own["index"][own["code"] == Code.PULL]]
            first = int(np.flatnonzero(part == number)[0])
            used = [operations[first:].ctypes.data, *(a.ctypes.data for a in mine)]
            used += received["sender"].tolist()
            used += [int(a["instance"][0]) for a in mine]
            used += [bound.signals[int(a["output"][0]) :].ctypes.data for a in mine]
            assert all(any(a <= place < b for a, b in spans) for place in used)
            assert x["n_links"] == len(received)


def test_a_stretch_of_a_row_is_of_one_part() -> None:
    places, never = np.arange(4), np.zeros(4, bool)
    found, owner = stretches(places, places, never, np.array([0, 0, 1, 1]))
    assert found["count"].tolist() == [2, 2] and owner.tolist() == [0, 1]


def test_threads_run_while_the_engine_is_open() -> None:
    with Engine(many(), threads=3) as engine:
        engine.initialize()
        engine.run(10)
        names = sorted(t.name for t in threading.enumerate() if t.name.startswith(threads.NAME))
        assert names == [f"{threads.NAME} 1", f"{threads.NAME} 2"]


def test_components_in_python_are_one_part_for_the_calling_thread() -> None:
    """Components that no other thread may step keep their order among themselves."""
    p = many()
    found = partition(p, [0, 3])
    assert found is not None and set(np.flatnonzero(found.part_of == 0)) >= {0, 3}
    everything = range(len(p.components))
    assert partition(p, everything) is None
    python = plan({f"a{i}": {"model": "Integrator"} for i in range(9)}, stop=500.0)
    assert recorded(python, 2)[1] == [0, 0, 0]


def test_components_in_python_run_beside_parts_that_threads_share() -> None:
    """The calling thread runs theirs, the first one; all others are shared."""
    document = read_document(CONFIGS / "many.toml")
    document["graphs"]["net"] = {"kind": "ring", "n": 12}
    document["run"]["stop"] = 2.0
    found = expand(document, CONFIGS / "many.toml")
    found["components"]["alpha"] = {"model": "tests.cosim.blocks:Milliseconds", "period": 0.005}
    found["components"]["omega"] = {"model": "tests.cosim.blocks:Clock", "period": 0.005}
    delay = {"law": "constant", "delay": 0.05}
    found["links"].append({"from": "omega.y[0]", "to": "alpha.u", "delay": delay})

    def made() -> Plan:
        return assemble(build(found, CONFIGS / "many.toml"))

    alone, _ = recorded(made(), 1)
    together, windows = recorded(made(), 3)
    assert together == alone and all(windows)


def test_a_link_that_takes_no_time_joins_its_ends() -> None:
    """Its receiver reads what its sender has sent in the same tick."""
    document = read_document(CONFIGS / "many.toml")
    document["graphs"]["net"] = {"kind": "ring", "n": 12}
    document["run"]["stop"] = 2.0
    found = expand(document, CONFIGS / "many.toml")

    def made() -> Plan:
        return assemble(build(found, CONFIGS / "many.toml"))

    def parts() -> int:
        divided = partition(made())
        return divided.count if divided else 1

    assert parts() == 12
    found["links"][3]["delay"] = {"law": "constant", "delay": 0}
    assert parts() == 11
    assert recorded(made(), 4)[0] == recorded(made(), 1)[0]


def test_a_wire_joins_its_ends() -> None:
    p = many()
    a, b = sorted(p.order)[:2]
    wire = replace(p.wires[0], source=p.component(a).outputs[0], target=p.component(b).inputs[0])
    wires = [w for w in p.wires if w.target.start != wire.target.start]
    other = compile_plan(p.h, p.ticks, p.components, [*wires, wire], p.links)
    found, before = partition(other), partition(p)
    assert found is not None and before is not None
    both = {i for i, c in enumerate(other.components) if c.name in (a, b)}
    assert len({int(found.part_of[i]) for i in both}) == 1
    assert len({int(before.part_of[i]) for i in both}) == 2
    assert sorted(set(found.operations[1])) == list(range(len(other.operations)))


@pytest.mark.parametrize("threads", [1, 3])
def test_the_first_component_that_fails_is_named(threads: int) -> None:
    """Oscillators that are far out leave the range of numbers; two do so in the same tick."""
    document = rings(30, TICKS)
    made = document.scenario("fmi2", TICKS)
    far = {"x": 1e3}
    components = {
        name: replace_start(spec, far) if name in ("f07", "f22") else spec
        for name, spec in made.components.items()
    }
    p = assemble(replace(made, components=components))
    with Engine(p, threads=threads) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"^f07: .* at tick \d+ ") as error:
            engine.run(TICKS)
        tick = engine.tick
    assert f"at tick {tick} " in str(error.value)
    assert EXPECTED.setdefault("said", str(error.value)) == str(error.value)


EXPECTED: dict[str, str] = {}


@pytest.mark.parametrize("columns", [None, [5, 2, 9, 8, 1]])
@pytest.mark.parametrize(
    ("fmi", "how", "which", "later"),
    [("2.0", 6, (2,), 0.0), ("3.0", 6, (2,), 0.0), ("3.0", 6, (1,), 0.0), ("3.0", 5, (2,), 0.0)]
    + [("3.0", 6, x, 0.0) for x in ((0, 4), (1, 3), (0, 2), (1, 2), (3, 4))]
    + [("3.0", how, x, later) for how in (5, 6) for x in ((1, 3), (1, 2)) for later in (0.0, 0.1)],
)
def test_a_run_that_stops_leaves_what_it_leaves_tick_by_tick(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fmi: str,
    how: int,
    which: tuple[int, ...],
    later: float,
    columns: list[int] | None,
) -> None:
    """Some of five FMUs end the simulation, or its step fails, in the middle of a window.

    The step of x1 is the first operation of a tick. The second of two stops `later`, s.
    """
    export(strict2() if fmi == "2.0" else strict3(""), tmp_path / "strict.fmu")
    text = "[run]\nstep = 0.1\nstop = 10.0\n"
    for i in range(5):
        when = 2.95 + later * (i in which[1:])
        end = f"{{ how = {how}, when = {when} }}" if i in which else "{ how = 0 }"
        text += f"[components.x{i}]\nmodel = 'strict.fmu'\nparameters = {end}\n"
        text += f"kind = '{'sampled' if i % 2 else 'continuous'}'\nstart = {{ u = {i + 1}.0 }}\n"
    (tmp_path / "s.toml").write_text(text)

    def stopped(threads: int) -> tuple[object, ...]:
        p = assemble(load(tmp_path / "s.toml"))
        rows = np.zeros((100, p.n_signals if columns is None else len(columns)))
        with Engine(p, threads=threads, columns=columns) as engine:
            engine.initialize()
            assert threads == 1 or engine.shares
            said = ""
            try:
                engine.run(100, rows)
            except RunError as error:
                said = str(error)
            assert bool(said) == (how == 5)
            n, now = engine.rows, engine.signals[columns or slice(None)]
            kept = now.tobytes() if how == 6 and fmi == "3.0" else b""
            return rows[:n].tobytes(), engine.tick, engine.ended, said, kept

    alone = stopped(1)
    assert 29 <= alone[1] <= 31 and stopped(3) == alone
    monkeypatch.setattr(binding, "ALONE", 2)
    assert stopped(1) == alone


def replace_start(spec: object, start: dict[str, float]) -> object:
    return replace(spec, start=start)


def test_a_run_with_threads_is_the_same_run(tmp_path) -> None:  # type: ignore[no-untyped-def]
    made = load(CONFIGS / "many.toml", ("graphs.net.n=12", "run.stop=2"))
    outcomes = [simulate(made, tmp_path / str(n), execution=Execution(n)) for n in (1, 2)]
    assert [outcome.shared for outcome in outcomes] == [False, True]
    one, two = ((tmp_path / str(t) / "trajectories.parquet").read_bytes() for t in (1, 2))
    assert one == two


def test_the_command_says_when_there_is_nothing_to_share(
    tmp_path, monkeypatch, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[no-untyped-def]
    from cosim.cli.options import RunSettings
    from cosim.cli.run import RunOptions, run

    monkeypatch.setattr(binding, "LEAST", 32)
    few = str(CONFIGS / "teleoperation.toml")
    for path, changes, said in (
        (few, ["run.stop=1"], "found nothing that 2 threads could share"),
        (str(CONFIGS / "many.toml"), ["run.stop=1", "graphs.net.n=40"], ""),
    ):
        settings = RunSettings(set_=changes)
        options = RunOptions(out=tmp_path / Path(path).stem, plot=False, threads=2)
        run(settings, options, Path(path))
        err = capsys.readouterr().err
        assert (said in err) if said else ("could share" not in err)
