"""Foundations: components, units, errors, clocks, reading of files.

Nothing here depends on scenarios or plans. `component` is the interface of a model in Python.
"""
