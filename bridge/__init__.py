"""Real time: a scenario divided into nodes on CAN and Zenoh buses, with a choice of clocks.

Each package is a room, and rooms stand on floors: a room imports those below it, never those above
(`lint-imports` checks it; `docs/design.md` has the picture). The work of a tick is done in C
(``bridge/c``, used through :mod:`bridge.native`), everything before and after in Python. This
package contains no code for particular models: a scenario names them.
"""

from bridge.can import mf4 as _mf4

_mf4.import_late()
