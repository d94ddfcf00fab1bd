"""Controllers that fail, and what the tests compare: small variants files and their runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.base.component import Parameter, Port
from cosim.base.errors import ScenarioError
from cosim.comparison.comparison import Comparison, compare
from cosim.comparison.documents import Base, check, read_base
from cosim.comparison.same_links import RecordedTable, keep
from cosim.comparison.variants import Variants
from cosim.comparison.variants_file import read
from cosim.links.storage import TableWriter

ROOT = Path(__file__).resolve().parents[3]
CONFIG = ROOT / "configs" / "teleoperation.toml"
VARIANTS = ROOT / "configs" / "compare" / "bilateral.toml"

#: A variants file for CONFIG with one of everything; cases are tried on changes of it.
SMALL = """
set = ["run.step=5 ms", "run.stop=2 s"]
[roles.master]
arm = "master"
controller = "master_control"
[roles.slave]
arm = "slave"
controller = "slave_control"
[wiring]
inputs = { q = "arm.q", dq = "arm.dq" }
drives = { tau = "controller.tau" }
[controllers.pd]
model = "fmus.models.pd"
preset = "PD(10,4)"
receives = { q_j = "arm.q", dq_j = "arm.dq" }
[operators.light]
master = { k_p = 10.0, k_d = 5.0 }
[links.constant]
delay = { law = "constant", delay = "100 ms" }
[columns.effort]
kind = "norm"
of = ["master.tau_h"]
[stable]
position = ["master.q", "slave.q"]
velocity = ["master.dq", "slave.dq"]
position_limit = 100.0
velocity_limit = 200.0
rest = 0.01
window = 1.0
[figure]
y = ["master.q[0]", "slave.q[0]"]
"""


class Push:
    """A controller that pushes with 1 N.m until `fail_at`, and fails then; a crash if so told."""

    kind = "sampled"
    inputs = (Port("q", (2,), "rad"), Port("dq", (2,), "rad/s"))
    outputs = (Port("tau", (2,), "N.m"),)
    parameters = (
        Parameter("fail_at", (1e9,), (), "s"),
        Parameter("crash", (0.0,), type="boolean"),
        Parameter("refuse", (0.0,), type="boolean"),
    )

    def initialize(self, values):
        self.fail_at = float(values.get("fail_at", 1e9))
        self.crash = bool(values.get("crash", False))
        if values.get("refuse", False):
            raise ScenarioError("will not start")

    def initial(self, u):
        return {"tau": [1.0, 1.0]}

    def step(self, t, h, u):
        if t >= self.fail_at:
            if self.crash:
                os._exit(3)
            raise ArithmeticError("no torque left")
        return {"tau": [1.0, 1.0]}

    def get_state(self):
        return None

    def set_state(self, state):
        del state


def push(name: str, **parameters: float | bool) -> str:
    """A controller of :class:`Push` as a variants file says it."""
    given = ", ".join(f"{key} = {str(value).lower()}" for key, value in parameters.items())
    model = "tests.cosim.comparison.parts:Push"
    return f'[controllers.{name}]\nmodel = "{model}"\nparameters = {{ {given} }}\n'


def written(folder: Path, text: str, name: str = "variants.toml") -> Path:
    """A file with this text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def compared(
    path: Path,
    controllers: Sequence[str] = (),
    operators: Sequence[str] = (),
    links: Sequence[str] = (),
    *,
    settings: Sequence[str] = (),
    seeds: Sequence[int] = (0,),
    jobs: int = 1,
) -> Comparison:
    """The comparison that a variants file makes of CONFIG."""
    variants, base = loaded(path, settings)
    chosen = variants.select(controllers, operators, links)
    check(base, variants, chosen)
    return compare(base, variants, chosen, seeds, jobs=jobs)


def loaded(path: Path, settings: Sequence[str] = ()) -> tuple[Variants, Base]:
    """A variants file, and CONFIG changed by it."""
    variants = read(path).with_columns(())
    return variants, read_base(CONFIG, variants, settings)


def stored(folder: Path, facts: Mapping[str, Any], rows: Sequence[int]) -> RecordedTable:
    """The table of a link that held these samples."""
    with TableWriter(folder / "table.parquet", facts) as writer:
        writer.write(rows)
    return keep(folder / "table.parquet", folder / "kept")
