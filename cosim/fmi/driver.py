"""Python components that drive an FMU themselves, in place of the engine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from cosim.base.component import Outputs
from cosim.fmi.component import FmuComponent


class FmuDriver(ABC):
    """A component with callbacks for its steps, and with the values, units and facts of an FMU."""

    fmu: FmuComponent

    @property
    @abstractmethod
    def connected(self) -> str:
        """Its connections other than signals, as text."""

    @abstractmethod
    def exit_initialization(self) -> Outputs:
        """Leave Initialization Mode; returns the outputs that may be new. Raises FmuError."""

    @abstractmethod
    def files(self) -> Mapping[str, str]:
        """Text files, by name, that are kept in the folder of a run."""
