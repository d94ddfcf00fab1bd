"""A deployment: which components live in which node, and which message carries what.

In come a scenario's plan and a deployment file, out comes a
:class:`~bridge.deployment.system.System`: the plans of all nodes, the signals that cross the
cuts, and the messages, routes, services, ranges, drives and delay lines that carry them. Nothing
is opened and nothing runs.
"""
