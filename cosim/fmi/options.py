"""Settings of an FMU in a scenario other than its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cosim.base.convert import Struct, field

#: How long (s) an FMU in a process of its own, or in a sandbox, may take to answer by default.
PATIENCE = 60.0


class FmuOptions(Struct, frozen=True):
    """`sizes`: structural parameters that are sizes of arrays; `texts`: start values of String and
    Binary variables (hexadecimal).

    `given`: parameters and start values as a scenario has them; those that are sizes or texts are
    taken out of it, see :attr:`cosim.fmi.FmuComponent.taken`.

    `log`: switch the FMU's logging on and keep what it says; `isolate`: a process of its own,
    killed when a call takes longer than `timeout` (s), with at most `memory` MB (0: no limit)
    more than at its start; `wasm`: its WebAssembly component, in a sandbox, also where it has a
    binary for here, with the same `timeout`, and with `memory` in all (0: 1024 MB); `build`:
    compile the FMU's sources where it has no binary for here.
    `tolerance`: relative tolerance of the FMU's own solver, or of CVODE; None: that of its
    DefaultExperiment. `interface`: that of several which is used, as the model description writes
    it; "": the first of co-simulation, model exchange, scheduled execution. `solver`: euler, heun,
    rk4 or cvode ("": rk4), with steps of at most `max_step` (s).
    """

    sizes: Mapping[str, int] = field(default_factory=dict)
    texts: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    given: Mapping[str, Any] = field(default_factory=dict)
    log: bool = False
    isolate: bool = False
    wasm: bool = False
    timeout: float = PATIENCE
    memory: int = 0
    build: bool = False
    tolerance: float | None = None
    interface: str = ""
    solver: str = ""
    max_step: float | None = None
