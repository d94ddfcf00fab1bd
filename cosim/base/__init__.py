"""What everything stands on: components, units, errors, clocks, reading of files.

Nothing here knows a scenario or a plan. `component` is what a model written in Python fulfils.
"""
