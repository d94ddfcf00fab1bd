"""An instance of an FMU in this process, for each version of FMI."""

from __future__ import annotations

from collections.abc import Callable

from cosim.fmi.library import Instance, Setup
from cosim.native import fmu_log


def instantiate(setup: Setup, log: fmu_log.Log | None = None) -> Instance:
    """An instance of an FMU. `log`: where it logs to; None: where this process keeps it.

    Raises FmuError.
    """
    kind: Callable[[Setup, fmu_log.Log], Instance]
    if setup.fmi == "2.0":  # few runs have FMUs of several versions
        from cosim.fmi.fmi2 import Instance2 as kind
    elif setup.fmi == "1.0":
        from cosim.fmi.fmi1 import Instance1, ModelInstance1

        kind = ModelInstance1 if setup.interface == "ModelExchange" else Instance1
    else:
        from cosim.fmi.fmi3 import Instance3 as kind
    return kind(setup, fmu_log.log() if log is None else log)
