"""Fault injection: which faults are injected, when, and where.

Input: fault scripts (TOML). Output: rules for the injector in C, and events for a supervisor.
"""
