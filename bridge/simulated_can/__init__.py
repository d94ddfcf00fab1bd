"""The python-can interface ``cosim``: a CAN bus with arbitration, exact frame times and errors.

Input: bus objects of python-can programs, in one process or several, clients of socketcand, other
traffic from files. Output: the frames they receive, error frames, states of the bus, accounts and
pictures. The bus itself is :mod:`cosim.bus`; this room gives it names, time and connections.
"""
