"""A deployment: which node runs which components, and which message carries which signal.

Input: the plan of a scenario and a deployment file. Output: a
:class:`~bridge.deployment.system.System`: the plans of all nodes, the signals that cross the
cuts, and the messages, routes, services, ranges, drives and delay lines that carry them. No bus
is opened and nothing is executed.
"""
