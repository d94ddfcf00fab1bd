"""Real time: a scenario cut into nodes, on CAN and Zenoh buses, on a clock of one's choice.

Each package is a room, and rooms stand on floors: a room imports those below it, never those above
(`lint-imports` checks it; `docs/design.md` has the picture). C does what happens in a tick
(``bridge/c``, seen through :mod:`bridge.native`), Python everything before and after. Models are
not known here: a scenario names them.
"""
