"""What can be said of a deployment before it runs.

In comes a system, out come findings with their advice: bus load, response times, identifiers that
collide, signals without a range, and what this host lacks.
"""
