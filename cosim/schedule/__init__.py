"""Who steps when: components and connections become a plan, an array of operations.

In come components, wires and links, out comes a :class:`~cosim.schedule.plan.Plan` that the
engine, a node or a study executes.
"""
