"""A plan executed: by the C engine, into memory or into a run folder.

In comes a plan, out come signals at every tick; `simulate` writes them as a run folder, `recovery`
completes the folder of a run that was killed.
"""
