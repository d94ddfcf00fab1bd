"""Grants of the operating system to a process, and the lateness of its slots.

Input: requests (a priority, locked memory, precise timers) and journals of slots. Output: what was
granted, the reason for what was not, and a report of lateness like cyclictest's.
"""
