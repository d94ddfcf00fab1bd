"""Ctrl-C at chosen moments: the run stops after the tick, and everything is closed properly."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cosim.engine.simulate
from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.base.errors import Interrupted
from cosim.base.interrupts import stop_on_signal, stops_on_signal
from cosim.engine.simulate import RunOutcome, simulate
from cosim.record import Run
from tests.system.runs import Document, scenario

DOCUMENT: Document = {
    "run": {"step": 0.001, "stop": 2.0},
    "components": {"ctrl_c": {"model": "tests.system.test_interrupts:Presses"}},
}


class Presses:
    """Sampled: y = t; presses Ctrl-C at the time `at`, s."""

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs = (Port("y", (), "s"),)
    parameters = (Parameter("at", (np.inf,), (), "s"),)

    def initialize(self, values: Values) -> None:
        self.at = float(values.get("at", np.array(np.inf)))

    def initial(self, u: Values) -> Outputs:
        return {"y": 0.0}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        if t == self.at:
            signal.raise_signal(signal.SIGINT)
        return {"y": t}


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    """Python's own handler, before and after."""
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def pressing(at: float) -> Document:
    components = {"ctrl_c": DOCUMENT["components"]["ctrl_c"] | {"parameters": {"at": at}}}
    return DOCUMENT | {"components": components}


@pytest.mark.parametrize("tick", [0, 1, 700, 1998])
def test_in_a_component(tmp_path: Path, tick: int) -> None:
    with pytest.raises(Interrupted) as stopped:
        simulate(scenario(pressing(tick * 0.001)), tmp_path / "run")
    assert stopped.value.time == (tick + 1) * 0.001
    assert stopped.value.saved == str(tmp_path / "run")
    result = Run.open(tmp_path / "run")
    assert np.array_equal(result.column("ctrl_c.y")[: tick + 1], np.arange(tick + 1) * 0.001)
    assert tick < len(result) <= tick + 2
    assert result.metadata["error"].startswith("Interrupted: interrupted at t = ")


def test_in_the_last_tick_the_run_is_complete(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        simulate(scenario(pressing(1.999)), tmp_path / "run")
    result = Run.open(tmp_path / "run")
    assert len(result) == 2001
    assert result.metadata["error"] is None


def test_between_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim.engine.simulate, "CHUNK_TICKS", 101)

    def press(done: int, _: int) -> None:
        if done == 300:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(Interrupted) as stopped:
        simulate(scenario(DOCUMENT), tmp_path / "run", press)
    assert stopped.value.time == 0.3
    assert np.array_equal(Run.open(tmp_path / "run").t, np.arange(300) * 0.001)


def test_a_second_one_does_not_wait() -> None:
    stopped: list[bool] = []
    with pytest.raises(KeyboardInterrupt), stop_on_signal(lambda: stopped.append(True)):
        signal.raise_signal(signal.SIGINT)
        assert stopped == [True]
        signal.raise_signal(signal.SIGINT)
        stopped.append(False)
    assert stopped == [True]


def test_what_went_wrong_comes_first() -> None:
    with pytest.raises(ValueError, match="broken"), stop_on_signal(lambda: None):
        signal.raise_signal(signal.SIGINT)
        raise ValueError("broken")


def test_somebody_else_s_handler_is_left_alone() -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: seen.append(number))
    try:
        with stop_on_signal(lambda: seen.append(-1)):
            signal.raise_signal(signal.SIGINT)
        assert seen == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_block_stops_its_loop_in_the_main_thread_until_other_code_takes_the_signal() -> None:
    def stop() -> None:
        raise AssertionError("no signal has come")

    found: list[bool] = []

    def ask() -> None:
        found.append(stops_on_signal(stop))

    ask()
    with stop_on_signal(lambda: None), stop_on_signal(stop):
        ask()
        thread = threading.Thread(target=ask)
        thread.start()
        thread.join()
        ours = signal.signal(signal.SIGINT, signal.default_int_handler)
        ask()
        signal.signal(signal.SIGINT, ours)
        ask()
    ask()
    assert found == [False, True, False, False, True, False]


def test_a_run_in_another_thread_has_no_handler(tmp_path: Path) -> None:
    done: list[RunOutcome] = []
    work = threading.Thread(
        target=lambda: done.append(simulate(scenario(DOCUMENT), tmp_path / "run"))
    )
    work.start()
    work.join()
    assert [outcome.ticks for outcome in done] == [2000]
