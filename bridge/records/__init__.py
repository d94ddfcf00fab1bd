"""Reports of nodes and their supervisor, as typed records, and the lives they belong to.

Input: the counters of a node and how it ended. Output: JSON files, and the same records read back.
"""
