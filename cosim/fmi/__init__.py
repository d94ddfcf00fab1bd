"""An ``.fmu`` as a Component: archive, description, library, component."""

from cosim.fmi.component import FmuComponent
from cosim.fmi.description import Description, read

__all__ = ["Description", "FmuComponent", "read"]
