"""Delays of the frames of one link on a simulated CAN bus, one for each sample that is sent.

Source: own construction; the bus is :mod:`cosim.bus.simulation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import Delays, FloatArray

if TYPE_CHECKING:
    from numpy.random import Generator


@dataclass(frozen=True, slots=True, eq=False)
class BusDelays:
    """Sample k arrived delay[k] after it was sent; `delay` (n,), s, infinite where it was lost.

    `known`: what is written down with the run (bus, identifier, response times). Raises
    ScenarioError if no sample arrives.
    """

    delay: FloatArray
    known: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a frame that no link receives. Raises ScenarioError."""
        if not np.isfinite(self.delay).any():
            raise ScenarioError(
                f"bus {self.known.get('bus')}: found no frame {self.known.get('identifier')} that"
                " arrives, expected at least one; look at load, errors and queues of this bus"
            )

    @property
    def minimum(self) -> float:
        """Shortest delay, s."""
        return float(self.delay[np.isfinite(self.delay)].min())

    @property
    def maximum(self) -> float:
        """Longest delay of a sample that arrived, s."""
        return float(self.delay[np.isfinite(self.delay)].max())

    @property
    def mean(self) -> float:
        """The mean delay of the samples that arrived, s."""
        return float(self.delay[np.isfinite(self.delay)].mean())

    @property
    def loses_packets(self) -> bool:
        """True if a sample did not arrive."""
        return not bool(np.isfinite(self.delay).all())

    def limit(self, period: Fraction) -> int | None:
        """The number of samples that the bus was simulated for."""
        return int(self.delay.size)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays in order; nothing is drawn.

        A test of `cosim analyze` that lasts longer than the run repeats them from the start.
        """
        return _Simulated(self.delay)

    def facts(self) -> dict[str, Any]:
        """Facts about the bus and the frame, and a digest of the delays."""
        digest = sha256(self.delay.astype("<f8").tobytes())
        return {"law": "bus", **self.known, "sha256": digest.hexdigest()}


class _Simulated:
    def __init__(self, delay: FloatArray) -> None:
        self._delay, self._sample = delay, 0

    def take(self, n: int) -> FloatArray:
        index = np.arange(self._sample, self._sample + n) % self._delay.size
        self._sample += n
        return self._delay[index]
