"""Components that fail in different ways."""

from __future__ import annotations

import os
from pathlib import Path
from time import sleep

from cosim.base.component import Parameter
from tests.cosim import blocks


class Trap(blocks.Gain):
    """Sampled: y = gain * u; from 1 s on, what `how` says: nothing, an exception, the end, an
    exception as long as there is no file ``mended``."""

    parameters = (
        Parameter("gain", (1.0,)),
        Parameter("how", (0.0,), type="integer"),
        Parameter("wait", (0.0,), (), "s"),
    )

    def initialize(self, values):
        super().initialize(values)
        self.how = int(values.get("how", 0))
        self.wait = float(values.get("wait", 0.0))

    def step(self, t, h, u):
        if t >= 1.0 and self.how == 1:
            raise ZeroDivisionError("one over nothing")
        if t >= 1.0 and self.how == 2:
            os._exit(3)
        if t >= 1.0 and self.how == 3 and not Path("mended").exists():
            raise ZeroDivisionError("not mended yet")
        if t == 0.0:
            sleep(self.wait)
        return {"y": self.gain * float(u["u"])}
