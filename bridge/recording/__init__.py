"""Recordings as a run folder: made from journals, read during the run, recovered after a crash.

Input: the journals of nodes that have ended, are running or were killed. Output: signals, link
tables and bus logs in common formats.
"""
