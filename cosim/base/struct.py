"""Small frozen objects of which a run has very many: structs of msgspec, which are made in a tenth
of the time of a frozen dataclass.

With ``gc=False`` Python's search for garbage does not look at them: for what is in no cycle of
references.
"""

from __future__ import annotations

from msgspec import Struct as Struct
from msgspec import field as field
from msgspec.structs import replace as replace
