"""What the operating system grants a process, and how late its slots were.

Input: requests (a priority, locked memory, precise timers) and journals of slots. Output: what was
granted, the reason for what was not, and a report of lateness like cyclictest's.
"""
