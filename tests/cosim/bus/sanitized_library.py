"""A pytest plug-in: the simulated bus is loaded from the path SANITIZED_BUS."""

from __future__ import annotations

import os
from pathlib import Path

from cosim.bus import structs

structs.library_path = lambda: Path(os.environ["SANITIZED_BUS"])
