"""A deployment computed without a wall clock: simulated, or again from what was recorded.

In come a system, and journals or a bus log; out come the rows of every node, and where they differ.
"""
