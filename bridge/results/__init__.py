"""Results of a run: report, numbers, detected faults, and verdict.

Input: the rows and records of all nodes. Output: a complete run folder, the report as text and as
data, and a verdict.
"""
