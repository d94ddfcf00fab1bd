"""Faults on purpose: what goes wrong, when, and to whom.

In come fault scripts (TOML), out come rules for the injector in C and events for a supervisor.
"""
