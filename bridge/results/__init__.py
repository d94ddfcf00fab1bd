"""What came of a run: report, numbers, faults that are to be seen in it, verdict.

In come the rows and records of all nodes, out come a complete run folder, the report in words and
as data, and one word on all of it.
"""
