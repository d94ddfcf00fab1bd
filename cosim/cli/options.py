"""Options that several commands share, each with one name and one meaning; what they write.

A parameter of a command that is a struct stands for its fields. A field is declared like a
parameter, ``Annotated[TYPE, typer.Option(...)] = DEFAULT``; a list is
``field(default_factory=list)``. So commands share options, and hand them on as one value.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import Parameter, Signature, signature
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO, TypeVar, get_type_hints

import typer

from cosim.base.convert import NODEFAULT, FieldInfo, Struct, field, fields
from cosim.base.copies import field_names
from cosim.base.extras import require
from cosim.base.toml import EXPECTED, is_usable_number

if TYPE_CHECKING:
    from cosim.study.parts import StudyPart

#: The value of an option.
Given = TypeVar("Given")


def drawn(value: Given) -> Given:
    """The callback of an option for which matplotlib draws. Raises ScenarioError without it."""
    if value:
        require("matplotlib")
    return value


Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Change a value; repeatable."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing run folder.")]
Plot = Annotated[
    bool, typer.Option("--plot/--no-plot", help="Write report.html, a page to look at the result.")
]
Png = Annotated[
    bool, typer.Option("--png", callback=drawn, help="Also draw the figures as PNG (matplotlib).")
]
Pdf = Annotated[
    bool, typer.Option("--pdf", callback=drawn, help="Also draw the figures as PDF (matplotlib).")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings before the run as errors.")]
StrictRun = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Treat warnings before the run as errors; exit with status 1 unless every "
        "requirement passes.",
    ),
]
#: The file that stands for standard output.
STDOUT = Path("-")


def _json_file(context: typer.Context, value: Path | None) -> Path | None:
    """The callback of ``--json``: with ``-`` whatever else is printed goes to standard error."""
    if value == STDOUT:
        _streams.append(sys.stdout)
        sys.stdout = sys.stderr
        context.call_on_close(_restore)
    return value


#: Standard output, while something else is printed to standard error.
_streams: list[TextIO] = []


def _output() -> TextIO:
    return _streams[-1] if _streams else sys.stdout


def _restore() -> None:
    sys.stdout = _streams.pop()


Json = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        callback=_json_file,
        help="Write the result as JSON; -: to standard output, and nothing else.",
    ),
]
Retry = Annotated[bool, typer.Option("--retry", help="Repeat the runs that failed.")]
Jobs = Annotated[int, typer.Option("--jobs", "--parallel", min=1, help="Number of parallel runs.")]
#: The number of processors, for :data:`Jobs`.
PROCESSORS = os.cpu_count() or 1
Verify = Annotated[
    bool, typer.Option("--verify/--no-verify", help="Check the SHA-256 sums of RUN first.")
]


#: The argument of commands that have :class:`PartOptions`.
Folders = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[FOLDER]...", help="With --merge: the folders of the parts."),
]


class PartOptions(Struct, frozen=True):
    """The part of many runs that this call makes, or parts that are put together."""

    part: Annotated[
        str,
        typer.Option(
            metavar="K/N",
            help="Only every N-th run from the K-th on, into a folder of its own in runs.",
        ),
    ] = ""
    merge: Annotated[
        bool, typer.Option("--merge", help="Put together what is in the folders of parts.")
    ] = False

    def asked(self, command: str, folders: list[Path]) -> StudyPart | None:
        """The part, None: all runs. Raises ScenarioError for options that do not fit together."""
        from cosim.base.errors import ScenarioError
        from cosim.study.parts import StudyPart

        if self.merge and self.part:
            raise ScenarioError("found --merge with --part, expected one of them", command)
        if self.merge and not folders:
            raise ScenarioError("found no folder, expected those of the parts", "--merge")
        if folders and not self.merge:
            raise ScenarioError(f"found {folders[0]} without --merge, expected both", command)
        return StudyPart.read(self.part) if self.part else None


class RunSettings(Struct, frozen=True):
    """Changes of the scenario of a run."""

    set_: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="PATH=VALUE",
            help="Change a value, e.g. components.master.parameters.k_p=20 (of a single FMU: "
            "m=2); repeatable.",
        ),
    ] = field(default_factory=list)
    stop: Annotated[
        str | None, typer.Option(metavar="TIME", help='Stop time (run.stop), e.g. 10 or "500 ms".')
    ] = None
    start: Annotated[
        str | None, typer.Option(metavar="TIME", help="Time at which the run begins (run.start).")
    ] = None
    seed: Annotated[int | None, typer.Option(help="Seed of links and topology (run.seed).")] = None
    record: Annotated[
        list[str],
        typer.Option(
            metavar="SIGNAL",
            help="Record these signals only (run.record.signals), e.g. plant.x, 'plant.*' or all, "
            "also variables of FMUs that are no outputs; repeatable.",
        ),
    ] = field(default_factory=list)

    @property
    def all(self) -> list[str]:
        """All of them as ``PATH=VALUE``."""
        from cosim.base.toml import as_toml

        own = {"seed": self.seed, "start": self.start, "stop": self.stop}
        found = [f"run.{key}={value}" for key, value in own.items() if value is not None]
        signals = [f"run.record.signals={as_toml(self.record)}"] if self.record else []
        return [*self.set_, *found, *signals]


class ResultOptions(Struct, frozen=True):
    """The result of a command: as a file, and as text."""

    json: Json = None
    quiet: Quiet = False

    def say(self, text: str) -> None:
        """Print `text`, unless the command is quiet."""
        if not self.quiet:
            typer.echo(text)

    def save(self, command: str, data: Mapping[str, Any]) -> None:
        """Write the `data` of a command where they are wanted. Raises RunError with the path."""
        if self.json is not None:
            write_json(self.json, command, data)


class OutputOptions(Struct, frozen=True):
    """The files and the text of a run."""

    out: Annotated[
        Path | None, typer.Option(help="Run folder to write. Default: runs/SCENARIO-DATE-TIME.")
    ] = None
    force: Force = False
    plot: Plot = True
    png: Png = False
    pdf: Pdf = False
    strict: StrictRun = False
    json: Json = None
    quiet: Quiet = False

    def folder(self, name: str) -> Path:
        """The run folder: `out`, or a new one in ``runs``; it is announced to the supervisor."""
        from cosim.base.clock import stamp
        from cosim.cli.supervise import announce_run_folder

        folder = self.out or unused_folder(Path("runs") / f"{name}-{stamp()}")
        announce_run_folder(folder)
        return folder

    def say(self, text: str) -> None:
        """Print `text`, unless the command is quiet."""
        if not self.quiet:
            typer.echo(text)


def finite(value: float | None) -> float | None:
    """The callback of a numeric option, in the unit its help gives. Raises BadParameter."""
    if value is not None and not is_usable_number(value):
        raise typer.BadParameter(f"found {value!r}; expected {EXPECTED}")
    return value


def wall_seconds(text: str, option: str) -> float:
    """Wall time in s: ``60s``, ``5 min``, ``5m``; a number alone is in s. Raises ScenarioError."""
    from string import ascii_letters

    from cosim.base.errors import ScenarioError, UnitError
    from cosim.base.units import quantity

    number = text.strip().rstrip(f"{ascii_letters}µ")
    unit = text.strip().removeprefix(number) or "s"
    try:
        found = quantity(f"{number.strip()} {'min' if unit == 'm' else unit}", "s")
    except UnitError:
        found = -1.0
    if found < 0.0:
        raise ScenarioError(f"found {text!r}, expected a time such as 60s", option)
    return found


def unused_folder(folder: Path) -> Path:
    """`folder`, or with -2, -3, … behind it: two runs may start in one second."""
    n, path = 1, folder
    while path.exists():
        n += 1
        path = folder.with_name(f"{folder.name}-{n}")
    return path


#: Version of what ``--json`` writes; it changes when a key changes its meaning or goes.
JSON_VERSION = 1


def write_json(path: Path, command: str, data: Mapping[str, Any]) -> None:
    """Write the result of a command as JSON, or print it for :data:`STDOUT`.

    Its first key, ``schema``, is ``cosim.COMMAND/VERSION``. Numbers that are not finite become
    null. Raises RunError with the path if it cannot be written.
    """
    from cosim.base.files import write_file

    document = {"schema": f"cosim.{command}/{JSON_VERSION}", **_plain(data)}
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False, default=str) + "\n"
    if path == STDOUT:
        _output().write(text)
        _output().flush()
    else:
        write_file(path, text)


def _plain(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float):
        return float(data) if isfinite(data) else None
    return data


def flat(function: Callable[..., None]) -> Callable[..., None]:
    """The command `function` as a library for commands wants it: a parameter for each option."""
    hints = get_type_hints(function, include_extras=True)
    groups = {name: fields(kind) for name, kind in hints.items() if field_names(kind)}
    parameters = [
        one
        for p in signature(function).parameters.values()
        for one in (
            map(_option, groups[p.name])
            if p.name in groups
            else [p.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[p.name])]
        )
    ]

    @wraps(function)
    def called(**given: Any) -> None:
        made = {name: hints[name](**_values(group, given)) for name, group in groups.items()}
        function(**given, **made)

    vars(called).update(__signature__=Signature(parameters), __annotations__={})
    return called


def _option(f: FieldInfo) -> Parameter:
    """The parameter of a field of a group."""
    default = None if _is_made(f) else Parameter.empty if f.default is NODEFAULT else f.default
    return Parameter(f.name, Parameter.KEYWORD_ONLY, default=default, annotation=f.type)


def _is_made(f: FieldInfo) -> bool:
    """True if each group has a value of its own if none is given, such as a list."""
    return f.default_factory is not NODEFAULT


def _values(group: tuple[FieldInfo, ...], given: dict[str, Any]) -> dict[str, Any]:
    """The values of a group among those `given`, from which they are taken out."""
    values = {f.name: given.pop(f.name) for f in group}
    return {f.name: values[f.name] for f in group if not _is_made(f) or values[f.name] is not None}
