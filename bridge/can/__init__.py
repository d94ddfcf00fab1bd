"""CAN: message layouts from DBC files, coding and protection, buses, logs, bus load.

In come DBC files, names of interfaces and logs; out come tables by which C encodes and decodes,
open buses for a node, logs as others read them, and how busy a bus will be. The mathematics of bits
and response times is :mod:`cosim.bus`.
"""
