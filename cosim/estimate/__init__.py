"""How large the error of a step is, by doing it again in halves.

In comes a plan, out come local errors of its continuous components and the step a tolerance wants.
"""
