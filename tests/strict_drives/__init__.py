"""Strict drives: processes that behave as vendors' documents say, and log what is done to them.

They judge from outside. Nothing of this project is imported here: only Python and python-can. Each
process is all drives of one bus::

    python -m tests.strict_drives damiao --interface udp_multicast --channel 239.74.163.2 \\
        --drives 1,2 --log left.jsonl --fault 'trip=0xD@2'

Written from: Damiao's register and status tables (DM-J series, MIT mode), ODrive's CANSimple
reference (firmware 0.6), CiA 301 and CiA 402-2 (IEC 61800-7-201), and ``docs/can.md`` for the
drive of our own protocol. `core` has what they share, `judged` reads the logs.
"""
