"""CAN: message layouts from DBC files, coding and protection, buses, logs, bus load.

Input: DBC files, names of interfaces, and logs. Output: tables with which C encodes and decodes,
open buses for a node, logs in common formats, and predicted bus loads. The mathematics of bits
and response times is :mod:`cosim.bus`.
"""
