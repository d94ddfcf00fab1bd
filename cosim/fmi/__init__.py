"""An ``.fmu`` as a Component: archive, description, library, component."""

from cosim.fmi.component import FmuComponent
from cosim.fmi.description import Description, read, structural_sizes
from cosim.fmi.options import FmuOptions

__all__ = ["Description", "FmuComponent", "FmuOptions", "read", "structural_sizes"]
