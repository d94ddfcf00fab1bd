"""Checks of a deployment before it runs.

Input: a system. Output: findings with advice: bus load, response times, identifiers that
collide, signals without a range, and what this host lacks.
"""
