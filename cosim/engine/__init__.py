"""Execution of a plan by the C engine, into memory or into a run folder.

Input: a plan. Output: signals at every tick; `simulate` writes them as a run folder, `recovery`
completes the folder of a run that was killed.
"""
