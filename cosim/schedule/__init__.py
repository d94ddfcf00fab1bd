"""The schedule: components and connections become a plan, an array of operations.

Input: components, wires and links. Output: a :class:`~cosim.schedule.plan.Plan` that the engine, a
node or a study executes.
"""
