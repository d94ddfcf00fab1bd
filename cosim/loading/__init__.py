"""Loading: a scenario from a file, which is TOML or the SSP of another tool.

In: a path and settings (``run.stop=5``). Out: a :class:`cosim.scenario.spec.Scenario`, or the
document it is built from. The readers of the two formats stand below (`scenario`, `ssp`).
"""
