"""Parameters from measured data: those with which a scenario comes nearest to a recording.

Input: a plan, a recording, and the range of each parameter. Output: the fitted values with
confidence intervals, and how well each signal is met before and after.
"""
