"""Rehearsals of a test: the nodes of a deployment in processes of their own."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import cosim
from bridge.deployment import spec as deployments
from bridge.deployment.changes import clock_settings, interface_settings
from bridge.deployment.spec import Deployment
from bridge.deployment.system import System, load_system
from bridge.rehearsal.hosts import listen_setting
from bridge.testing.case import PytestCase
from bridge.testing.limit import time_limit
from bridge.testing.runs import files, repeated
from cosim.api.running import as_settings
from cosim.base.convert import Number
from cosim.base.errors import ScenarioError

if TYPE_CHECKING:
    from bridge.faults.script import FaultScript

#: Wall time that a rehearsal may take, unless its call says otherwise.
LIMIT = "120 s"


@final
class RehearsalRuns:
    """Rehearsals on buses and ports that no other test sees."""

    def __init__(self, case: PytestCase) -> None:
        self._case = case

    def __call__(
        self,
        scenario: str | Path,
        deploy: str = "",
        *,
        set: Mapping[str, Any] | None = None,
        clock: str = "",
        faults: str | Path = "",
        limit: Number = LIMIT,
    ) -> cosim.RunResult:
        """Rehearse a deployment: a file, or a name in ``deploy/`` next to the scenario.

        Its CAN buses are simulated ones, and its Zenoh nodes listen on free ports of this machine.
        `clock`: "wall", or by default, without a fault script `faults`, one that no busy machine
        disturbs: simulated (CAN) or lockstep (Zenoh). `limit`: the wall time that it may take, s.
        Raises CosimError, and TimeLimitError.
        """
        case, folder = self._case, self._case.next_run("rehearsal")
        with case.at_home(), time_limit(limit):
            paths = files(scenario, deploy)
            found = deployments.load(paths[1])
            clock = clock or ("wall" if faults else _steady(found))
            if faults and clock != "wall":
                raise ScenarioError(f"found faults with the clock {clock}; expected wall", "clock")
            changes = [*_apart(found), *clock_settings(found, clock)]
            changes += as_settings(case.settings(set))
            script = Path(faults).absolute() if faults else None
            system = load_system(paths[0], str(paths[1]), changes)
            _rehearse(system, paths, changes, script, folder)
            return cosim.open(folder)


def _steady(deployment: Deployment) -> str:
    """The clock on which a rehearsal takes as long as it needs, with the same result."""
    kinds = {bus.kind for bus in deployment.buses.values()}
    if len(kinds) > 1:
        return "wall"
    return "simulated" if "can" in kinds else "lockstep"


def _apart(deployment: Deployment) -> Iterator[str]:
    """Settings by which no other test hears this deployment."""
    yield from interface_settings(deployment, "cosim")
    for name, bus in deployment.buses.items():
        listening = bus.options.get("listen") if bus.kind == "zenoh" else None
        if not isinstance(listening, Mapping):
            continue
        with ExitStack() as held:  # all at once, so that no port is given twice
            for node in listening:
                port = held.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1]
                yield listen_setting(name, node, f"127.0.0.1:{port}", ("tcp/{}",))


def _rehearse(
    system: System, paths: tuple[Path, Path], changes: list[str], script: Path | None, folder: Path
) -> None:
    """Run the nodes to their end, and complete the folder of the run."""
    from bridge.rehearsal.supervisor import Rehearsal, Settings
    from bridge.results.outcome import begin, complete

    read, events = _faults(system, script)
    settings = Settings(
        *paths, tuple(changes), realtime=False, script=str(script or ""), events=events
    )
    words = ["rehearse", str(paths[0]), "--deploy", str(paths[1])]
    words += ["--faults", str(script)] if script else []
    facts = {
        "settings": changes, "faults": settings.script, "real": False,
        "command": repeated(words, changes),
    }  # fmt: skip
    folder.mkdir(parents=True)
    begin(system, folder, facts)
    with Rehearsal(system, settings, folder) as rehearsal:
        rehearsal.run()
        rehearsal.end()
        complete(system, folder, rehearsal.ended, facts, with_twin=False, script=read)


def _faults(system: System, script: Path | None) -> tuple[FaultScript | None, Any]:
    """A fault script, and its events in a rehearsal."""
    if script is None:
        return None, ()
    from bridge.faults.load import load
    from bridge.rehearsal import injector

    read = load(script)
    return read, injector.events(read, system)
