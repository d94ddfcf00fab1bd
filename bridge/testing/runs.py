"""Runs of a test: a scenario offline, its twin, its rehearsal."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import cosim
from bridge.testing.case import PytestCase
from bridge.testing.limit import time_limit
from cosim.api.running import as_settings
from cosim.base.convert import Number

#: Wall time that a run may take, unless its call says otherwise.
LIMIT = "60 s"


@final
class ScenarioRuns:
    """Offline runs of a test."""

    def __init__(self, case: PytestCase) -> None:
        self._case = case

    def __call__(
        self,
        scenario: str | Path | Mapping[str, Any],
        *,
        set: Mapping[str, Any] | None = None,
        limit: Number = LIMIT,
    ) -> cosim.RunResult:
        """Run a scenario: a file, relative to that of the test, or a mapping with the same keys.

        `set`: changes by dotted path, as :func:`cosim.run` takes them; ``run.seed`` is that of the
        test unless it is among them. `limit`: the wall time that the run may take, s. Raises
        CosimError as :func:`cosim.run`, and TimeLimitError.
        """
        case = self._case
        with case.at_home(), time_limit(limit):
            return cosim.run(scenario, set=case.settings(set), out=case.next_run("run"))


@final
class TwinRuns:
    """Twins of deployments: their nodes, codecs and buses on a simulated clock."""

    def __init__(self, case: PytestCase) -> None:
        self._case = case

    def __call__(
        self,
        scenario: str | Path,
        deploy: str = "",
        *,
        set: Mapping[str, Any] | None = None,
        limit: Number = LIMIT,
    ) -> cosim.RunResult:
        """Run the twin of a deployment: a file, or a name in ``deploy/`` next to the scenario.

        "": the one with the name of the scenario, or else ``can``. `set`: also of the deployment,
        ``deploy.…``. `limit`: the wall time that it may take, s. Raises CosimError, and
        TimeLimitError.
        """
        from bridge.deployment.system import load_system
        from bridge.results.outcome import run_twin

        case, folder = self._case, self._case.next_run("twin")
        with case.at_home(), time_limit(limit):
            paths, changes = files(scenario, deploy), as_settings(case.settings(set))
            system = load_system(paths[0], str(paths[1]), changes)
            command = repeated(["run", str(paths[0]), "--deploy", str(paths[1])], changes)
            run_twin(system, folder, changes, {"command": command})
            return cosim.open(folder)


def files(scenario: str | Path, deploy: str) -> tuple[Path, Path]:
    """The files of a scenario and its deployment."""
    from bridge.deployment.spec import find

    path = Path(scenario).absolute()
    return path, find(path, deploy).absolute()


def repeated(words: Sequence[str], changes: Sequence[str]) -> str:
    """The command with these words and changes."""
    return shlex.join(["cosim", *words, *(w for change in changes for w in ("--set", change))])
