"""The signals of a port in a recorded run, row by row, in pieces where the run is long."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import final

import numpy as np

from cosim.measure.energy import net_power
from cosim.measure.manipulability import RunningManipulability
from cosim.predict.facts import Array
from cosim.predict.inputs import RunWithInputs
from cosim.predict.port import PortSignals
from cosim.record.piecewise import RunningIntegral, extent, pieces
from cosim.record.signals import Signals


@dataclass(frozen=True, slots=True)
class PortRows:
    """Rows of a port: `t` (n,) s, the others (n, m) by their role.

    `far`: (torque, velocity) at the other end; `moved`: the response, and in a network the mean
    position of all robots, q_c.
    """

    t: Array
    force: Array
    response: Array
    rate: Array | None
    far: tuple[Array, Array] | None
    moved: Array


@final
class RecordedPort:
    """The recorded signals at a port; they are read anew for each pass over its rows.

    `units` of force and response; `size`: of the response; `rows`: how many there are, `first` and
    `last`: their times, s; `estimates`: final theta_hat of each robot, () if it was not recorded;
    `moving`: whether a velocity was recorded; `far`: whether the other end was; `mean`: whether the
    positions of all robots of a network were. Raises ScenarioError where a signal is missing.
    """

    def __init__(self, signals: Signals, port: PortSignals) -> None:
        self._signals, self._port = signals, port
        run = signals.run if isinstance(signals, RunWithInputs) else signals
        self.rows, self.first, self.last = extent(run)
        self.units = signals.unit(port.force), signals.unit(port.response)
        self.size = len(signals.entries(port.response))
        self.moving, self.mean = bool(port.rate), bool(port.members)
        self.far = bool(port.far_force and port.far_rate)
        self.estimates = tuple(self._last(name) for name in port.estimates)
        ends = [port.external, *((port.far_external, port.far_rate) if self.far else ())]
        self._names = [port.force, port.response, port.rate, *ends, *port.members]
        self._names += [port.far_force] if self.far else []
        next(iter(self))  # says what is missing

    @property
    def unit(self) -> str:
        """Unit of response over force."""
        force, response = self.units
        return f"{response}/({force})" if "." in force else f"{response}/{force}"

    def __iter__(self) -> Iterator[PortRows]:
        """All rows."""
        port = self._port
        for piece in self._pieces([name for name in self._names if name]):
            response = piece.array(port.response)
            far = None
            if self.far:
                force = _total(piece, port.far_force, port.far_external, -1.0)
                far = force, piece.array(port.far_rate)
            yield PortRows(
                t=np.asarray(piece.t, dtype=np.float64),
                force=_total(piece, port.force, port.external, 1.0),
                response=response,
                rate=piece.array(port.rate) if self.moving else None,
                far=far,
                moved=_mean(piece, port.members) if self.mean else response,
            )

    @property
    def M(self) -> Iterator[tuple[Array, Array]]:
        """Times, s, and M^t, (n,) each, of rows in pieces."""
        M = RunningManipulability()
        for rows in self:
            yield rows.t, M.add(rows.t, rows.force, rows.moved)

    @property
    def E(self) -> Iterator[tuple[Array, Array]]:
        """Times, s, and the passivity observer, J, (n,) each; nothing without a velocity."""
        E = RunningIntegral()
        for rows in self:
            if rows.rate is not None:
                ends = [(rows.force, rows.rate), *([rows.far] if rows.far else [])]
                yield rows.t, E.add(net_power(ends), rows.t)

    def final(self) -> Array:
        """The last response, (1, m); (0, m) where nothing was recorded."""
        found = np.empty((0, self.size))
        for piece in self._pieces([self._port.response], self.last):
            found = piece.array(self._port.response)[-1:]
        return found

    def _last(self, name: str) -> tuple[float, ...]:
        """The last values of a signal; () if nothing was recorded."""
        found: tuple[float, ...] = ()
        for piece in self._pieces([name], self.last):
            found = tuple(float(x) for row in piece.array(name)[-1:] for x in row)
        return found

    def _pieces(self, names: Sequence[str], since: float = -inf) -> Iterator[Signals]:
        if isinstance(self._signals, RunWithInputs):
            return self._signals.pieces(names, since)
        return pieces(self._signals, names, since)


def _mean(signals: Signals, names: Sequence[str]) -> Array:
    """The mean of signals of one size, (n, m), without a copy of all of them."""
    total = np.array(signals.array(names[0]), dtype=np.float64)
    for name in names[1:]:
        total += signals.array(name)
    return np.asarray(total / len(names))


def _total(signals: Signals, inside: str, external: str, sign: float) -> Array:
    """The torque of a grip or wall inside an arm, (n, m), with what other components feed in."""
    found = signals.array(inside)
    return found + sign * signals.array(external) if external else found
