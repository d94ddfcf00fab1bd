"""Threads that share the ticks of many FMUs: the same bytes, and the same failures."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.cases import rings
from cosim.base.errors import RunError
from cosim.engine import team
from cosim.engine.engine import Engine
from cosim.engine.simulate import simulate
from cosim.loading.files import load, read_document
from cosim.native.structs import Code
from cosim.scenario.arrays import expand
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.scenarios import plan

TICKS = 1500


@pytest.fixture(autouse=True)
def small_segments(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Share segments of any size."""
    monkeypatch.setattr(team, "LEAST", 1)
    yield
    left = [t for t in threading.enumerate() if t.name.startswith(team.NAME)]
    assert not left  # they end with the engine


def recorded(p: Plan, threads: int, ticks: int = TICKS) -> tuple[bytes, list[int]]:
    """All signals at all ticks, in calls of different length; which segments are shared."""
    rows, shared = np.empty((ticks, p.n_signals)), []
    with Engine(p, threads=threads) as engine:
        engine.initialize()
        for first in range(0, ticks, 700):
            n = min(700, ticks - first)
            assert engine.run(n, rows[first : first + n]) == n
            shared = [s.shared for s in engine._bound.segments]
    return rows.tobytes(), shared


def many(*changes: str) -> Plan:
    return assemble(load(CONFIGS / "many.toml", ("graphs.net.n=12", "run.stop=2", *changes)))


@settings(max_examples=12)
@given(threads=st.integers(2, 6), n=st.integers(3, 20), seed=st.integers(0, 3))
def test_any_number_of_threads_gives_the_same_bytes(threads: int, n: int, seed: int) -> None:
    changes = (f"graphs.net.n={n}", 'graphs.net.kind="ring"', f"run.seed={seed}")
    alone, none = recorded(many(*changes), 1)
    together, shared = recorded(many(*changes), threads)
    assert together == alone
    assert sum(shared) >= 3 and not any(none)


@pytest.mark.parametrize("config", ["network", "teleoperation"])
def test_shipped_scenarios_give_the_same_bytes(config: str) -> None:
    def made() -> Plan:
        return assemble(load(CONFIGS / f"{config}.toml", ("run.stop=2",)))

    assert recorded(made(), 3)[0] == recorded(made(), 1)[0]


@pytest.mark.parametrize("choice", ["fmi2", "fmi3", "kernel"])
def test_every_kind_of_native_component_is_shared(choice: str) -> None:
    alone, _ = recorded(rings(40, TICKS).plan(choice, TICKS), 1)  # type: ignore[arg-type]
    together, shared = recorded(rings(40, TICKS).plan(choice, TICKS), 2)  # type: ignore[arg-type]
    assert together == alone and any(shared)


def test_threads_run_while_the_engine_is_open() -> None:
    with Engine(many(), threads=3) as engine:
        engine.initialize()
        engine.run(10)
        names = sorted(t.name for t in threading.enumerate() if t.name.startswith(team.NAME))
        assert names == [f"{team.NAME} 1", f"{team.NAME} 2"]


def test_python_components_are_not_shared() -> None:
    p = plan({f"a{i}": {"model": "Integrator"} for i in range(9)}, stop=500.0)
    _, shared = recorded(p, 2)
    assert not any(shared)


def test_a_link_that_takes_no_time_keeps_its_order() -> None:
    """Its receiver reads what its sender has sent in the same tick."""
    document = read_document(CONFIGS / "many.toml")
    document["graphs"]["net"] = {"kind": "ring", "n": 12}
    document["run"]["stop"] = 2.0
    found = expand(document, CONFIGS / "many.toml")

    def made() -> Plan:
        return assemble(build(found, CONFIGS / "many.toml"))

    assert recorded(made(), 4)[1][0]
    found["links"][3]["delay"] = {"law": "constant", "delay": 0}
    together, shared = recorded(made(), 4)
    assert together == recorded(made(), 1)[0]
    assert not shared[0] and any(shared)  # the controllers one by one, the arms together


def test_wires_between_sampled_components_keep_their_order() -> None:
    p = many()
    controllers = p.segments[0]
    assert controllers.independent
    blocks = set(controllers.blocks)
    starts = [p.operations[i].code for i in controllers.blocks[:-1]]
    assert Code.STEP not in starts and len(blocks) == 13
    a, b = sorted(name for name in p.order)[:2]
    wire = replace(p.wires[0], source=p.component(a).outputs[0], target=p.component(b).inputs[0])
    from cosim.schedule.plan import compile_plan

    wires = [w for w in p.wires if w.target.start != wire.target.start]
    other = compile_plan(p.h, p.ticks, p.components, [*wires, wire], p.links)
    assert not other.segments[0].independent


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
    import msgspec

    p = assemble(msgspec.structs.replace(made, components=components))
    with Engine(p, threads=threads) as engine:
        engine.initialize()
        with pytest.raises(RunError, match=r"^f07: .* at tick \d+ ") as error:
            engine.run(TICKS)
        tick = engine.tick
    assert f"at tick {tick} " in str(error.value)
    assert EXPECTED.setdefault("said", str(error.value)) == str(error.value)


EXPECTED: dict[str, str] = {}


def replace_start(spec: object, start: dict[str, float]) -> object:
    import msgspec

    return msgspec.structs.replace(spec, start=start)


def test_a_run_with_threads_is_the_same_run(tmp_path) -> None:  # type: ignore[no-untyped-def]
    made = load(CONFIGS / "many.toml", ("graphs.net.n=12", "run.stop=2"))
    outcomes = [simulate(made, tmp_path / str(n), threads=n) for n in (1, 2)]
    assert [outcome.shared for outcome in outcomes] == [False, True]
    one, two = ((tmp_path / str(t) / "trajectories.parquet").read_bytes() for t in (1, 2))
    assert one == two


def test_the_command_says_when_there_is_nothing_to_share(
    tmp_path, monkeypatch, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[no-untyped-def]
    from cosim.cli.run import run

    monkeypatch.setattr(team, "LEAST", 32)
    few = str(CONFIGS / "teleoperation.toml")
    for path, changes, said in (
        (few, ["run.stop=1"], "found nothing that 2 threads could share"),
        (str(CONFIGS / "many.toml"), ["run.stop=1", "graphs.net.n=40"], ""),
    ):
        run(
            Path(path), set_=changes, stop=None, seed=None, record=None, table=None,
            out=tmp_path / Path(path).stem, links=None, deploy=None, json=None, threads=2,
            plot=False,
        )  # fmt: skip
        err = capsys.readouterr().err
        assert (said in err) if said else ("could share" not in err)
