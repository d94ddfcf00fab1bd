"""Every signal ends a command: what swallows an interruption, or never asks, is reminded."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
import typer

from cosim.base import clock, interrupts
from cosim.base.errors import RunError
from cosim.base.interrupts import (
    acknowledge,
    act_on_signal,
    exit_code,
    signals_as_interrupt,
    stop_on_signal,
    until_signal,
)
from cosim.cli.ending import ProgramGroup, run_program


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "PATIENCE", 0.02)
    monkeypatch.setattr(interrupts, "AGAIN", 0.02)


def _come() -> None:
    signal.raise_signal(signal.SIGTERM)


def test_the_handler_raises_nothing_and_the_next_place_that_asks_does() -> None:
    said = []
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        _come()
        said.append("goes on")
        act_on_signal()
        said.append("too far")
    assert said == ["goes on"]
    assert exit_code() == 128 + signal.SIGTERM


def _waits() -> None:
    subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"], check=False)


@pytest.mark.parametrize("work", [lambda: clock.sleep(60), lambda: time.sleep(60), _waits])
def test_who_waits_is_interrupted(work: Callable[[], None]) -> None:
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        _come()
        work()


def test_an_interruption_that_code_swallows_comes_again() -> None:
    swallowed = 0
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        _come()
        while swallowed < 3:
            try:
                time.sleep(60)
            except:  # noqa: E722
                swallowed += 1
    assert swallowed  # or it came between two of them


def test_code_that_ends_before_it_is_reminded_has_been_interrupted() -> None:
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        _come()


@pytest.mark.parametrize("clean", [lambda: time.sleep(0.1), lambda: sum(range(3_000_000))])
def test_what_cleans_up_is_not_interrupted(clean: Callable[[], object]) -> None:
    cleaned = False
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        try:
            _come()
            act_on_signal()
        finally:
            try:
                raise ValueError("another error, while the interruption is handled")
            except ValueError:
                clean()
            cleaned = True
    assert cleaned


def test_a_signal_that_comes_by_two_ways_is_one() -> None:
    """A service manager sends it to all processes, and the supervisor passes it on."""
    interrupts.PATIENCE = 60.0
    stopped = []
    with (
        pytest.raises(KeyboardInterrupt),
        signals_as_interrupt(),
        stop_on_signal(lambda: stopped.append("stopped")),
    ):
        _come()
        _come()
        stopped.append("saved")
    assert stopped == ["stopped", "saved"]


def test_all_loops_that_run_are_stopped_and_the_outermost_raises() -> None:
    stopped = []
    with (
        pytest.raises(KeyboardInterrupt),
        signals_as_interrupt(),
        stop_on_signal(lambda: stopped.append(1)),
    ):
        with stop_on_signal(lambda: stopped.append(2)):
            _come()
            time.sleep(0.1)  # longer than the patience
        act_on_signal()
        stopped.append(3)
    assert stopped == [1, 2, 3]


def test_after_a_signal_is_acknowledged_only_another_one_interrupts() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), signals_as_interrupt():
        with until_signal():
            _come()
            clock.sleep(60)
        time.sleep(0.1)
        done.append("completed")
        act_on_signal()
        _come()
        done.append("too far")
    assert done == ["completed"]


def _swallows() -> None:
    _come()
    try:
        clock.sleep(60)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


def _completes() -> None:
    with until_signal():
        _come()
        clock.sleep(60)


def _fails() -> None:
    try:
        _swallows()
    except typer.Exit:
        raise RunError("lost") from None


@pytest.mark.parametrize(
    ("work", "said"),
    [(_come, "interrupted\n"), (_swallows, "interrupted\n"), (_completes, ""),
     (_fails, "error: lost\n")],
)  # fmt: skip
def test_the_exit_code_is_that_of_the_signal(work, said, capsys) -> None:
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(work)
    with pytest.raises(SystemExit) as end:
        run_program(lambda: app([]))
    assert end.value.code == 143
    assert capsys.readouterr().err == said


def test_a_signal_in_a_python_program_of_others_is_theirs() -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with signals_as_interrupt():
            _come()
            act_on_signal()
            acknowledge()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM]


@pytest.mark.parametrize("code", [0, 3, "text"])
def test_a_command_in_which_others_exit_has_not_finished(code: object, capsys) -> None:
    app = typer.Typer(cls=ProgramGroup, add_completion=False, pretty_exceptions_enable=False)
    app.callback()(lambda: None)
    app.command("exits")(lambda: sys.exit(code))
    with pytest.raises(SystemExit) as end:
        run_program(lambda: app(["exits"]))
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: a component or a module ended this command: sys.exit({code!r})")
