"""What the operating system grants a process, and how late its slots were.

In come wishes (a priority, memory that stays, precise timers) and journals of slots; out come what
was granted and why not, and a report of lateness like cyclictest's.
"""
