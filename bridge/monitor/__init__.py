"""Monitoring of a rehearsal, during the run or afterwards, without disturbing it.

Input: the journals of a run folder, or the frames of its buses. Output: snapshots, tables, a
figure, and messages for plotting tools.
"""
