"""Loading: a scenario from a file, which is TOML or the SSP of another tool.

In: a path and settings (``run.stop=5``). Out: a :class:`cosim.scenario.spec.Scenario`, or the
document from which it is built. The readers of the two formats are in `scenario` and `ssp`.
"""
