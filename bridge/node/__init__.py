"""One node as a process or a thread: configure, wait for the start, tick in C, report.

Input: a system, the name of a node, and commands. Output: frames on its buses, its journals and
its report. `start` is what a supervisor starts, `run` what both ways have in common.
"""
