"""No child of a test comes back into pytest, where it would run its parent's tests again."""

from __future__ import annotations

import ast
import gc
import os
import signal
import subprocess
import sys
import tomllib
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from bridge.realtime.requests import Realtime, enter
from cosim.live.keys import movable
from cosim.loading.files import load
from tests import garbage
from tests.bridge.deployments import TELEOPERATION
from tests.children import FAILED, fork

TESTS = Path(__file__).resolve().parents[1]
FORKS = {"fork", "forkpty"}


def _forks(file: Path) -> bool:
    """A call of `os.fork` and the like, or the context of multiprocessing that forks."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            words = [a.value for a in node.args if isinstance(a, ast.Constant)]
            owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
            if owner in {"os", "pty"} and node.func.attr in FORKS:
                return True
            if node.func.attr == "get_context" and "fork" in words:
                return True
    return False


def test_one_module_forks() -> None:
    found = [str(file.relative_to(TESTS)) for file in TESTS.rglob("*.py") if _forks(file)]
    assert found == ["children.py"]


def _raises() -> int:
    raise KeyboardInterrupt


def _exits(code: object) -> int:
    sys.exit(code)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("work", "code"),
    [
        (lambda: 3, 3),
        (lambda: None, FAILED),
        (lambda: "3", FAILED),
        (_raises, FAILED),
        (lambda: _exits(None), 0),
        (lambda: _exits(4), 4),
        (lambda: _exits("a sentence"), FAILED),
        (lambda: pytest.exit("all tests"), FAILED),
        (lambda: os.kill(os.getpid(), signal.SIGTERM), -signal.SIGTERM),
    ],
)
def test_a_child_ends_whatever_its_work_does(work: Callable[[], int], code: int) -> None:
    _, status = os.waitpid(fork(work), 0)
    assert os.waitstatus_to_exitcode(status) == code


def test_a_child_does_not_outlive_its_parent() -> None:
    """It would hold the pipes of its parent open, at whose end somebody waits."""
    program = "import time; from tests.children import fork; fork(lambda: time.sleep(60))"
    call = [sys.executable, "-c", program]
    done = subprocess.run(call, cwd=TESTS.parent, stdout=subprocess.PIPE, timeout=30)
    assert done.returncode == 0


CACHING = "from functools import cache\n@cache\ndef runs(n=0):\n    return bytearray(1 << 23)"


def module(name: str) -> ModuleType:
    """A module with a function that caches results of 8 MiB."""
    made = ModuleType(name)
    exec(CACHING, vars(made))
    return made


def results(made: ModuleType) -> int:
    """The number of results that are cached."""
    return int(vars(made)["runs"].cache_info().currsize)


def test_what_the_tests_of_a_file_have_cached_goes_with_the_file() -> None:
    made, other, tidier = module("made"), ModuleType("other"), garbage.Tidier()
    vars(made)["runs"]()
    tidier.after(made, made)
    assert results(made) == 1
    tidier.after(made, other)
    assert results(made) == 0


def test_many_results_of_helpers_go_where_a_process_has_grown(monkeypatch) -> None:
    helper, library = module("tests.made"), module("cosim.made")
    for made in (helper, library):
        monkeypatch.setitem(sys.modules, made.__name__, made)
    vars(library)["runs"]()
    tidier, files = garbage.Tidier(), (ModuleType("made"), ModuleType("other"))
    assert not tidier.after(*files)
    for n in range(garbage.MANY):
        vars(helper)["runs"](n)
    assert tidier.after(*files)
    assert (results(helper), results(library)) == (0, 1)
    assert not tidier.after(*files)


def test_the_names_of_functions_stay_whose_addresses_do() -> None:
    """Else a report was not live after the tests of many FMUs: the calls of its start were kept."""
    recorded = load(TELEOPERATION).run.record.signals
    document = tomllib.loads(TELEOPERATION.read_text("utf-8"))
    for _ in range(2):
        assert movable(document, TELEOPERATION, recorded).keys
        garbage.forget(sys.modules["cosim.fmi.library"])


class Left:
    """An object that refers to itself, with some memory."""

    def __init__(self) -> None:
        self.itself, self.memory = self, b"x" * (2 * garbage.GARBAGE << 20)


def test_garbage_of_a_test_does_not_wait_for_the_end_of_its_file() -> None:
    tidier, made = garbage.Tidier(), ModuleType("made")
    gone = weakref.ref(Left())
    tidier.after(made, made)
    assert gone() is None


def test_what_a_node_of_a_test_sets_aside_goes_with_it() -> None:
    gone = weakref.ref(left := Left())
    with enter(Realtime(priority=0, timer_slack_ns=0, lock_memory=False, cpu_latency_us=None)):
        del left
    gc.collect()
    assert gone() is None
