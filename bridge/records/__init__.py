"""What nodes and their supervisor report, as typed records, and the lives they belong to.

In come the counts and ends of a node, out come JSON files, and the same records read back.
"""
