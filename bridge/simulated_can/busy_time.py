"""Busy times of a simulated wire: the transmission under way, and those of the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import final

from bridge.simulated_can.node import WireNode
from cosim.bus.frames import BusFrame
from cosim.bus.simulation import BitCounter
from cosim.bus.timing import BusTiming

HISTORY_S = 10
"""How long the wire remembers when it was busy, s."""
_HISTORY_PS = HISTORY_S * 10**12
_INTERMISSION = 3
"""Bits after a frame before the next can start."""
_AFTER_ERROR = 6 + 8 + _INTERMISSION
"""Least bits from the detection of an error to the end of the intermission: flag, delimiter."""


@final
class BusyTime:
    """Follows the events of a wire. Times are ps since the wire exists.

    Busy is from a start of frame to the end of the intermission, also of a failed attempt.
    """

    def __init__(self, timing: BusTiming) -> None:
        self._bit_ps = round(1e12 / timing.bitrate)
        self._data_bit_ps = round(1e12 / (timing.data_bitrate or timing.bitrate))
        self._count = BitCounter().bits
        self.free_ps = 0
        self._sent: dict[WireNode, tuple[int, BusFrame]] = {}
        self._troubled = False
        self._began_ps: int | None = None
        self._spans: deque[tuple[int, int]] = deque()

    @property
    def sending(self) -> bool:
        """True if a frame is on the wire."""
        return bool(self._sent)

    @property
    def under_way(self) -> bool:
        """True if a frame or an error frame is on the wire."""
        return bool(self._sent) or self._troubled

    def start(self, time_ps: int, node: WireNode, frame: BusFrame | None) -> None:
        """A node sends a start of frame."""
        if not self._sent:
            if self._began_ps is not None:
                ended_ps = time_ps if self._troubled else self.free_ps
                self._spans.append((self._began_ps, ended_ps))
            self._began_ps = time_ps
        if frame is not None:
            self._sent[node] = (time_ps, frame)

    def lose(self, node: WireNode) -> None:
        """A node has lost arbitration."""
        self._sent.pop(node, None)

    def end(self, time_ps: int, failed: bool) -> Iterable[BusFrame]:
        """A frame was sent, or has failed; returns the frames of all that sent."""
        attempted = [frame for _, frame in self._sent.values()]
        self._sent.clear()
        if failed:
            self._troubled = True
        after = _AFTER_ERROR if self._troubled else _INTERMISSION
        self.free_ps = time_ps + after * self._bit_ps
        return attempted

    def free(self, time_ps: int) -> None:
        """All nodes are idle again after an error frame."""
        self.free_ps, self._troubled = time_ps, False

    def next_end(self, now_ps: int) -> int | None:
        """The end of the frame on the wire, if nothing disturbs it; None: there is none."""
        ends = [start_ps + self.length_ps(frame) for start_ps, frame in self._sent.values()]
        return min((end_ps for end_ps in ends if end_ps > now_ps), default=None)

    def length_ps(self, frame: BusFrame) -> int:
        """The time from the start of frame to the end of its last bit, ps."""
        nominal, data = self._count(frame)
        return (nominal - _INTERMISSION) * self._bit_ps + data * self._data_bit_ps

    def forget(self, now_ps: int) -> None:
        """Drop what is over: frames that should have ended, and times before HISTORY_S."""
        if self._sent:
            for node, (start_ps, frame) in list(self._sent.items()):
                if start_ps + self.length_ps(frame) <= now_ps:
                    del self._sent[node]
        oldest = now_ps - _HISTORY_PS
        while self._spans and self._spans[0][1] < oldest:
            self._spans.popleft()

    def share(self, now_ps: int, window_ps: int) -> float:
        """The share of the last `window_ps` (ps) in which the wire was busy, 0 to 1."""
        begin = max(0, now_ps - window_ps)
        spans = [*self._spans, *self._current(now_ps)]
        taken = sum(max(0, min(end, now_ps) - max(start, begin)) for start, end in spans)
        return taken / (now_ps - begin) if now_ps > begin else 0.0

    def _current(self, now_ps: int) -> list[tuple[int, int]]:
        """The transmission that began last, as far as it is known."""
        if self._began_ps is None:
            return []
        return [(self._began_ps, now_ps if self.under_way else self.free_ps)]
