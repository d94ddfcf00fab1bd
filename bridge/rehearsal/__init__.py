"""All nodes of a deployment at once, on the wall clock: started, watched, collected.

In come a system, settings and a fault script, out comes how each node's process ended. `hosts` puts
nodes into network namespaces, `injector` and `babbler` do to them what a script says.
"""
