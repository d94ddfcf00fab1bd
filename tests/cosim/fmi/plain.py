"""Small FMUs of FMI 2.0 made of ``c/plain2.c``: y_i = u_i + p_i, with the habits of other tools."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from fmus.build.toolchain import compile_shared, shared_suffix

SOURCE = Path(__file__).parent / "c" / "plain2.c"
FOLDER = tempfile.TemporaryDirectory(prefix="plain-")
#: First value references.
U, P, Y, TIME = 0, 16, 32, 48


def real(name: str, reference: int, causality: str, start: str = "0", more: str = "") -> str:
    """A Real variable; `more`: attributes of its type."""
    begin = f'start="{start}"' if start and causality != "output" else ""
    fixed = ' variability="fixed"' if causality == "parameter" else ""
    return (
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}"'
        f"{fixed}><Real {begin} {more}/></ScalarVariable>"
    )


def described(
    variables: Sequence[str],
    identifier: str = "plain2",
    token: str = 'guid="t"',
    experiment: str = "",
    attributes: str = "",
    inside: str = "",
) -> str:
    """The description; `inside`: of the element CoSimulation."""
    return f"""<fmiModelDescription fmiVersion="2.0" modelName="plain" {token}>
<CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true"
 {attributes}>{inside}</CoSimulation>{experiment}<ModelVariables>{"".join(variables)}</ModelVariables>
<ModelStructure/></fmiModelDescription>"""


@lru_cache
def library(defines: tuple[tuple[str, str | None], ...] = ()) -> bytes:
    """The compiled C file with these macros."""
    output = Path(FOLDER.name) / f"plain{abs(hash(defines))}{shared_suffix()}"
    return compile_shared([SOURCE], output, defines=dict(defines)).read_bytes()


def export(
    path: Path,
    description: str,
    defines: Mapping[str, str | None] | None = None,
    files: Mapping[str, bytes] | None = None,
) -> Path:
    """An FMU at `path`; `files`: more entries by name, in place of the binary where one is it."""
    identifier = description.split('modelIdentifier="')[1].split('"')[0]
    entries = {f"binaries/linux64/{identifier}{shared_suffix()}": b"", **(files or {})}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        for name, data in entries.items():
            archive.writestr(name, data or library(tuple(sorted((defines or {}).items()))))
    return path


def counted(base: int = 1, n: int = 3, **how: object) -> str:
    """Inputs f, parameters p and outputs r of `n` entries each, counted from `base`."""
    variables = [
        real(f"{name}[{base + i}]", first + i, causality)
        for name, first, causality in (
            ("f", U, "input"), ("p", P, "parameter"), ("r", Y, "output"),
        )
        for i in range(n)
    ]  # fmt: skip
    return described([*variables, real("now", TIME, "output")], **how)  # type: ignore[arg-type]
