"""Settings and fixtures of all tests."""

import gc
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

from tests.footprint import Footprint
from tests.garbage import Tidier, freeze_tests, return_memory

# A loaded machine is slow, and slowness is measured elsewhere.
_ALL: dict[str, Any] = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.too_slow],
    "print_blob": True,
}
#: Property tests try the same examples every time: a change is not refused for a find that has
#: nothing to do with it. `pytest -m hypothesis --hypothesis-profile=search` tries more and others.
settings.register_profile("project", derandomize=True, max_examples=25, **_ALL)
settings.register_profile("search", max_examples=int(os.environ.get("EXAMPLES", "1000")), **_ALL)
# Whether one fails is all that tests.mutants asks.
_WITHOUT_SHRINKING = (Phase.explicit, Phase.generate)
settings.register_profile("mutants", derandomize=True, phases=_WITHOUT_SHRINKING, **_ALL)
settings.load_profile("project")


# As the command does for itself (cosim/cli/__init__.py), here before a test imports NumPy: in each
# process of tests a second thread of OpenBLAS would wait busily beside the other processes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Arrow's own pool keeps 70 MiB for what the tests once asked of it, and gives nothing back.
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
# Python would look for garbage among thousands of collected tests every 700 new objects, which
# takes a tenth of all processor time.
gc.set_threshold(50_000)


_TIDIER: list[Tidier] = []
_LAST: list[pytest.Item] = []


def pytest_collection_finish() -> None:
    """No search for garbage looks at the thousands of collected tests."""
    freeze_tests()
    _TIDIER[:] = [Tidier()]


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Any:
    """Clear what the tests of a file have left."""
    done = yield
    for last in _LAST:
        vars(last).pop("cancel_timeout", None)  # pytest-timeout leaves a thread's objects there
        if "PYTEST_XDIST_WORKER" in os.environ:
            vars(last).clear()  # a test that was run is not looked at again; each has 10 KB
    _LAST[:] = [item]
    reporter = item.config.pluginmanager.getplugin("terminalreporter")
    if reporter is not None and "PYTEST_XDIST_WORKER" in os.environ:
        reporter.stats.clear()  # three reports a test, which no one here prints
    modules = [x.module if isinstance(x, pytest.Function) else None for x in (item, nextitem)]
    if modules[0] is not None and _TIDIER:
        _TIDIER[0].after(modules[0], modules[1])
    return done


@pytest.fixture(scope="session")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder where tests of this run keep what they have compiled; its processes share it."""
    folder = tmp_path_factory.getbasetemp()
    return (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "objects"


@pytest.fixture
def compiled_once(objects: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the same sources once for all tests with this fixture."""
    from tests.objects import keep

    keep(objects, monkeypatch.setattr)


def pytest_configure(config: pytest.Config) -> None:
    """Commands that tests start heed Ctrl-C, also where the tests run in the background."""
    return_memory()
    config.pluginmanager.register(Footprint(), "footprint")
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
