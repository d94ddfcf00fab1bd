"""FMI-LS-BUS 1.0 for CAN: FMUs exchange bus operations in Binary variables, over a simulated bus.

:mod:`cosim.lsbus.codec` encodes and decodes the operations; :mod:`cosim.lsbus.exchange` is the bus
that they are addressed to; :mod:`cosim.lsbus.network` connects FMUs to it. docs/bus.md says what
is supported.
"""
