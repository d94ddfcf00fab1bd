"""``delay.h``: a link's configured latency at its receiving side. See there for the semantics."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.native import enums
from bridge.native.library import library
from bridge.native.structs import Delay, SampleStruct, WaitingStruct
from cosim.base.errors import PlanError
from cosim.links.semantics import QueueSemantics

__all__ = ["Delay", "DelayLine", "SampleStruct", "WaitingStruct"]
NONE, SIGNAL, LAST = enums.DELAY_NONE, enums.DELAY_SIGNAL, enums.DELAY_LAST
STAMP, FIFO, PLAYOUT = enums.DELAY_STAMP, enums.DELAY_FIFO, enums.DELAY_PLAYOUT
QUEUE = enums.DELAY_QUEUE
FloatArray = NDArray[np.float64]


@final
class DelayLine:
    """A `delay_t` and its memory.

    `width`: values of a sample; `period`, `look`: of sender and receiver, base ticks of `h` (s);
    `delays`: s, one per step of the receiver (SIGNAL) or per sample; `buffer`: s (PLAYOUT), or the
    rule of a queue (QUEUE); `phase_ns`: phase of the receiver's slots minus that of the sender's.
    Raises PlanError for a `capacity` (samples) that is not a power of two, and without a sample or
    a step of the receiver.
    """

    def __init__(
        self,
        kind: int,
        width: int,
        period: int,
        look: int,
        h: float,
        capacity: int,
        delays: FloatArray | Sequence[float] = (),
        buffer: float | QueueSemantics = 0.0,
        phase_ns: int = 0,
    ) -> None:
        if capacity < 1 or capacity & (capacity - 1):
            raise PlanError(f"a delay line of {capacity} samples; expected a power of two")
        if min(width, period, look) < 1 or not h > 0:
            raise PlanError(
                f"a delay line of {width} values, every {period} and {look} ticks of {h} s;"
                " expected more than 0 of each"
            )
        self._delays = np.ascontiguousarray(delays, dtype=np.float64)
        self._samples = (SampleStruct * capacity)()
        self._queue = (WaitingStruct * capacity)()
        self._values = np.zeros((capacity + 1, width))
        self.struct = Delay(kind=kind, width=width, period=period, look=look, h=h)
        self.struct.phase_ns = phase_ns
        if isinstance(buffer, QueueSemantics):
            self._line = (c.c_int64 * buffer.depth)()
            self.struct.line = c.addressof(self._line)
            self.struct.depth = buffer.depth
            self.struct.drops_newest = buffer.drop == "newest"
            self.struct.takes_all = buffer.take == "all"
        else:
            self.struct.buffer = buffer
        self.struct.delays, self.struct.n_delays = self._delays.ctypes.data, self._delays.size
        self.struct.capacity = capacity
        self.struct.samples = self._samples
        self.struct.queue = self._queue
        self.struct.values = self._values.ctypes.data
        self._library = library()
        self.reset()

    @property
    def lead_ns(self) -> int:
        """Samples sent less than this before a look do not change what it gives, ns."""
        return int(self._library.delay_lead_ns(c.byref(self.struct)))

    @property
    def address(self) -> int:
        """The address of the `delay_t`, valid as long as this lives."""
        return c.addressof(self.struct)

    def reset(self) -> None:
        """Empty, nothing held, nothing counted."""
        self._library.delay_reset(c.byref(self.struct))

    def put(self, sequence: int, sent_ns: int, arrival_ns: int, values: Sequence[float]) -> None:
        """A sample (width,) that has arrived; times are ns since the start of the run."""
        row = (c.c_double * self.struct.width)(*values)
        self._library.delay_put(c.byref(self.struct), sequence, sent_ns, arrival_ns, row)

    def take(self, row: int, now_ns: int = 0) -> int:
        """The sequence number held at look `row`, -1: none yet. Rows ascend."""
        return int(self._library.delay_take(c.byref(self.struct), row, now_ns))

    def values(self) -> FloatArray:
        """The held values, (width,), a copy; without a meaning while nothing is held."""
        held: FloatArray = self._values[-1].copy()
        return held
