"""An instance of an FMU in this process, for each version of FMI."""

from __future__ import annotations

from cosim.fmi.fmi1 import Instance1
from cosim.fmi.fmi2 import Instance2
from cosim.fmi.fmi3 import Instance3
from cosim.fmi.library import Instance, Setup
from cosim.native import fmu_log


def instantiate(setup: Setup, log: fmu_log.Log | None = None) -> Instance:
    """An instance of an FMU. `log`: where it logs to; None: where this process keeps it.

    Raises FmuError.
    """
    kinds: dict[str, type[Instance1] | type[Instance2] | type[Instance3]]
    kinds = {"1.0": Instance1, "2.0": Instance2, "3.0": Instance3}
    return kinds[setup.fmi](setup, fmu_log.log() if log is None else log)
