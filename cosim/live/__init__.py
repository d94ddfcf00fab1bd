"""Reports that run their scenario again in the browser

In come a scenario and its run; out goes a page in which values can be moved. It holds engine and
models as WebAssembly, the image of the plan that they compute with the bits of the command line,
and what it takes to judge a run in JavaScript, with the numbers and words of Python.
"""

from __future__ import annotations

from cosim.live.bundle import bundle
from cosim.live.image import LiveError
from cosim.record.digest import digest

__all__ = ["LiveError", "bundle", "digest"]
