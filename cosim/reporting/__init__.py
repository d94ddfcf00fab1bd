"""Figures of a run and of an analysis.

In come a run folder or an analysis, out come PNG files.
"""
