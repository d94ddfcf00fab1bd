"""Systems of other tools: SSP 1.0 and 2.0 read as scenarios, scenarios written as SSP 1.0.

``load`` reads a ``.ssp`` as :class:`cosim.scenario.spec.Scenario`; :mod:`cosim.ssp.export` writes
one.
"""

from cosim.ssp.document import load

__all__ = ["load"]
