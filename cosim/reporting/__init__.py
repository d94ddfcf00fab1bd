"""Figures of a run and of an analysis.

Input: a run folder or an analysis. Output: PNG files.
"""
