"""The steps from a deployment to real drives that may move, each checked.

Input: a deployment and its buses. Output: a finding for each step and each drive, with its cure:
interfaces, drives, registers, watchdogs, directions, emergency stop.
"""
