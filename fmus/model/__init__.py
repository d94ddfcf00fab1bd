"""The declaration of a model: its variables with units and start values, and what is given to it.

``declaration`` holds :class:`Model` and :class:`Variable`; ``attributes`` says what FMI says of a
variable; ``start`` checks what a reference model is given and gives; ``numeric`` is NumPy, loaded
when a law is evaluated.
"""

from fmus.model.declaration import (
    Causality,
    Model,
    Terminal,
    Variable,
    annotation,
    any_size,
    clocked,
    exchanged,
)

__all__ = [
    "Causality",
    "Model",
    "Terminal",
    "Variable",
    "annotation",
    "any_size",
    "clocked",
    "exchanged",
]
