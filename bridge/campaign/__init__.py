"""Campaigns and soak tests: many runs with injected faults, each checked.

Input: a campaign or soak file and a seed. Output: runs (simulated or rehearsed), a verdict on each,
and a table. Runs that already exist are not repeated.
"""
