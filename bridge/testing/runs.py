"""Runs of a test: a scenario offline, its twin, its rehearsal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import cosim
from bridge.testing.case import PytestCase
from bridge.testing.limit import time_limit
from cosim.base.convert import Number

#: s of wall time that a run may take, unless its call says otherwise.
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
