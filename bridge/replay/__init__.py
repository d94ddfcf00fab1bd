"""A deployment computed without a wall clock: simulated, or again from what was recorded.

Input: a system, and journals or a bus log. Output: the rows of every node, and the differences.
"""
