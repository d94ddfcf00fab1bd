"""Options, fixtures and hooks of pytest; docs/testing.md shows them in use.

Every fixture is for one test: it works in the folder of the test's file, writes below ``tmp_path``,
and takes its random numbers from the name of the test.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from bridge.testing.buses import CanBuses
    from bridge.testing.case import PytestCase
    from bridge.testing.networks import HostNetworks
    from bridge.testing.references import References
    from bridge.testing.rehearsals import RehearsalRuns
    from bridge.testing.runs import ScenarioRuns, TwinRuns

_CASE: pytest.StashKey[PytestCase] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plug-in."""
    group = parser.getgroup("cosim", "co-simulation (cosim-bridge)")
    group.addoption(
        "--cosim-out",
        metavar="DIR",
        help="Keep the runs of every failed test in DIR, with reports and the commands that "
        "repeat them. Default: in the temporary folder of the test.",
    )
    group.addoption(
        "--cosim-update",
        action="store_true",
        help="Write reference runs anew, instead of comparing with them.",
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Attach what a failed test has run."""
    report = yield
    if report.failed and _CASE in item.stash:
        case = item.stash[_CASE]
        del item.stash[_CASE]
        try:
            properties, text = case.kept()
        except Exception as error:  # whatever it is: the other tests go on
            properties, text = [], f"not kept: {type(error).__name__}: {error}"
        item.user_properties += properties
        report.user_properties += properties
        report.sections.append(("cosim", text))
    return report


@pytest.fixture
def cosim_case(request: pytest.FixtureRequest, tmp_path: Path) -> PytestCase:
    """The test as the other fixtures know it: its seed, its folder, and what it has run."""
    from bridge.testing.case import PytestCase, name_of

    config, node = request.config, request.node
    given = config.getoption("cosim_out")
    case = PytestCase(
        name=name_of(node),
        root=config.rootpath,
        file=Path(request.path),
        folder=tmp_path / "cosim",
        out=None if given is None else config.invocation_params.dir / given,
    )
    node.stash[_CASE] = case
    node.user_properties.append(("cosim.seed", case.seed))
    return case


@pytest.fixture
def cosim_run(cosim_case: PytestCase) -> ScenarioRuns:
    """Run scenarios offline: ``cosim_run("law.toml", set={...})`` returns a cosim.RunResult."""
    from bridge.testing.runs import ScenarioRuns

    return ScenarioRuns(cosim_case)


@pytest.fixture
def twin(cosim_case: PytestCase) -> TwinRuns:
    """Run twins of deployments: ``twin("law.toml", set={...})`` returns a cosim.RunResult."""
    from bridge.testing.runs import TwinRuns

    return TwinRuns(cosim_case)


@pytest.fixture
def can_bus(cosim_case: PytestCase) -> Iterator[CanBuses]:
    """Open simulated buses: ``can_bus(2, bitrate=500_000)`` returns two nodes of one."""
    from contextlib import ExitStack

    from bridge.testing.buses import CanBuses

    with ExitStack() as closing:
        yield CanBuses(cosim_case, closing)


@pytest.fixture
def rehearsal(cosim_case: PytestCase) -> RehearsalRuns:
    """Rehearse deployments: ``rehearsal("law.toml")`` returns a cosim.RunResult."""
    from bridge.testing.rehearsals import RehearsalRuns

    return RehearsalRuns(cosim_case)


@pytest.fixture
def network(cosim_case: PytestCase) -> Iterator[HostNetworks]:
    """Make hosts with links: ``network(["a", "b"], {"a>b": {...}})`` is a RelayNetwork."""
    from contextlib import ExitStack

    from bridge.testing.networks import HostNetworks

    with ExitStack() as closing:
        yield HostNetworks(cosim_case, closing)


@pytest.fixture
def reference(cosim_case: PytestCase, request: pytest.FixtureRequest) -> References:
    """The kept run of a test: ``assert run.is_identical_to(reference(run))``."""
    from bridge.testing.references import References

    return References(cosim_case, update=bool(request.config.getoption("cosim_update")))
