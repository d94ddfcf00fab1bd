"""Names of the semantics of links; see :mod:`cosim.links.semantics`.

Apart from the laws, so that a scenario without links loads none of them.
"""

from typing import Literal

Semantics = Literal["signal", "last-arrival", "newest-stamp", "fifo", "playout"]
