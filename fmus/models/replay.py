"""Playback of a recording: measured or simulated signals become the inputs of another run.

From the time of a row on, each output holds the row's value (zero-order hold). Before the first row
it holds the first value, and after the last row the last value::

    y(t) = row i,   t_i <= t < t_i+1

Source: own construction.

Sampled. The model exists in Python only, because a kernel reads no files. A scenario names a
function without arguments, in a module of the user, that creates the model::

    def operator():
        return Replay("session.parquet", {"tau_h": "master.tau_h"})

    [components.hand]
    model = "my_module:operator"

A recording is a run folder, a Parquet file with a column ``t`` (units in the columns' metadata), or
a CSV file as a run writes it, whose first line names the columns, including ``t`` (s). The entries
of a vector are the columns ``name[0]``, ``name[1]``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.component import Kind, Parameter, Port
from cosim.record.recording import Recording

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values


@final
class Replay:
    """Plays `signals` of the recording at `path`: name of the output -> name in the recording.

    `units`: of outputs; needed for CSV files, which contain none (default "1"), and not used for
    Parquet files. Raises ScenarioError, with the file and, if known, the line, for a recording that
    cannot be read or lacks a signal.
    """

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __init__(
        self, path: str | Path, signals: Mapping[str, str], units: Mapping[str, str] | None = None
    ) -> None:
        recording = Recording.read(path, tuple(signals.values()))
        self._t = recording.t
        self._rows = {name: recording.signal(column) for name, column in signals.items()}
        known = {name: recording.unit(column) for name, column in signals.items()}
        given = units or {}
        self.outputs: tuple[Port, ...] = tuple(
            Port(
                name,
                rows.shape[1:],
                known[name] or given.get(name, "1"),
                f"{signals[name]} of the recording",
            )
            for name, rows in self._rows.items()
        )

    def initialize(self, values: Values) -> None:
        """Go to the start; there is nothing to set."""

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start: those of t = 0."""
        return self._at(0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; t may be h / 10^6 short of a row's time."""
        return self._at(t + 1e-6 * h)

    def _at(self, t: float) -> Outputs:
        row = max(0, int(np.searchsorted(self._t, t, side="right")) - 1)
        return {name: rows[row] for name, rows in self._rows.items()}

    def get_state(self) -> object:
        """None: the outputs depend on time only."""
        return None

    def set_state(self, state: object) -> None:
        """Continue; there is nothing to go back to."""
