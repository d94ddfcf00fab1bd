"""The python-can interface ``cosim``: a CAN bus with arbitration, exact frame times and errors.

Input: bus objects of python-can programs, in one process or several. Output: the frames they
receive, error frames and states of the bus. The bus itself is :mod:`cosim.bus`; this room gives it
names, time and connections, and :mod:`bridge.bus_server` serves it to other processes.
"""
