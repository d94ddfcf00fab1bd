"""The page in a folder of firmware: how it is used, and its table of sizes."""

from __future__ import annotations

from dataclasses import dataclass

from fmus.firmware.measure import Ran, Sizes, obstacle
from fmus.firmware.targets import Target
from fmus.model import Model


@dataclass(frozen=True, slots=True)
class Row:
    """The measures of the program of one compiler; `ran` None: no emulator is installed."""

    compiler: str
    sizes: Sizes
    ran: Ran | None

    def text(self) -> str:
        """The row in words."""
        s, r = self.sizes, self.ran
        sizes = f"{self.compiler}: text {s.text}, data {s.data}, bss {s.bss} bytes"
        if r is None:
            return f"{sizes}; not run, since the emulator is not installed"
        used = f"stack {r.stack} bytes, {r.instructions} instructions per step"
        return f"{sizes}; {used}; the bits of the FMU"


def page(model: Model, target: Target, rows: list[Row], digest: str) -> str:
    """The text of README.md."""
    name = model.identifier
    board = ", ".join(f"`{file}`" for file in target.board)
    example = _example(model)
    return f"""\
# {name} for {target.name}

{model.description}. Processor: {target.processor}.

| file | content |
|---|---|
| `{name}.h`, `{name}.c` | the model; it allocates no memory, and needs `memcpy` and `memset` only |
| `check.c` | steps with random inputs, and a digest of all variables |
| {board} | the board: change these for yours |
| `Makefile` | `make` builds the check, `make run` runs it; `CC=...` chooses the compiler |

```c
#include "{name}.h"

static {name}_t x;

const char *why = {name}_init(&x); /* NULL, or a message */
/* change parameters here, then: why = {name}_start(&x); */
for (int k = 0;; k++) {{ /* every {model.step:g} s */
{example[0]}    why = {name}_step(&x, k * {name}_STEP, {name}_STEP);
{example[1]}}}
```

After a message nothing has changed: the outputs are those of the step before, and the caller
decides what the drives do. Compile without contraction (`-ffp-contract=off`) and without
`-ffast-math`, or the bits are not those of the FMU.

The digest of the check is that of the FMU, `{digest}`.
{_table(rows, target)}"""


def _example(model: Model) -> list[str]:
    """A line for the inputs and one for the outputs; empty where there are none."""
    lines = []
    for causality, verb in (("input", "set"), ("output", "use")):
        names = [v.symbol or v.name for v in model.variables if v.causality == causality]
        listed = ", ".join(f"x.{name}" for name in names[:3]) + (", ..." if names[3:] else "")
        lines.append(f"    /* {verb} {listed} */\n" if names else "")
    return lines


def _table(rows: list[Row], target: Target) -> str:
    if not target.script:
        return ""
    if not rows:
        return f"\n## Size and time\n\nNot measured: {obstacle(target)}.\n"
    head = ("compiler", "text", "data", "bss", "frames", "stack", "instructions", "at most")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for row in rows:
        s, r = row.sizes, row.ran
        numbers = [s.text, s.data, s.bss, s.frames]
        numbers += [r.stack, r.instructions, r.most] if r else [None] * 3
        cells = ("–" if n is None else f"{n}" for n in numbers)
        lines.append(f"| {row.compiler} | {' | '.join(cells)} |")
    note = f"`{target.emulator[0]}` was not installed: the program was not run.\n"
    missing = any(row.ran is None for row in rows)
    table = "\n".join(lines)
    return f"""
## Size and time

{table}

{note if missing else ""}Bytes, of the whole check: model, board and the routines of the compiler.
`frames` are the frames of the model's functions that call each other, at most (`-fstack-usage`, GCC
only); `stack` is the most that the steps of the check used in the emulator, also by the compiler's
routines. Instructions are those of a step, on average and at most, counted by the emulator
(`-icount`), which counts the same in every run; how long they take depends on the processor.
"""
