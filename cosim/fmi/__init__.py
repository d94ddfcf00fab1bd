"""An ``.fmu`` as a Component: archive, description, library, component."""

from cosim.fmi.component import FmuComponent
from cosim.fmi.description import Description, read
from cosim.fmi.options import FmuOptions

__all__ = ["Description", "FmuComponent", "FmuOptions", "read"]
