"""A model in C: the source files of its library, some of them generated here.

``variables.h`` (the struct `Model`) and ``variables.c`` (the tables for the FMI layer) are
generated from the declaration; the other files are in ``fmus/c``. Together with the declaration
they determine the token by which an FMU's description and its binary recognize each other.
"""

from __future__ import annotations

import hashlib
import json
import re
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from math import inf
from pathlib import Path

from cosim.base.copies import asdict, replace
from cosim.base.errors import FmuError
from fmus.model import Model, Variable

_FOLDER = Path(__file__).parents[1] / "c"
#: The generic layer: what every library consists of besides the model.
_GENERIC = (
    "clock.c",
    "exchange.c",
    "fmi2.c",
    "fmi2_exchange.c",
    "fmi2_refused.c",
    "fmi3.c",
    "fmi3_events.c",
    "fmi3_exchange.c",
    "fmi3_refused.c",
    "instance.c",
    "kernel.c",
    "state.c",
    "stepping.c",
)
_HEADERS = (
    "declaration.h",
    "export.h",
    "fmi2.h",
    "fmi2_types.h",
    "fmi3.h",
    "fmi3_types.h",
    "instance.h",
    "model.h",
    "real.h",
    "trig.h",
    "trig_reduced.h",
)
#: What a model has besides whose step is written for several instances (``fmus/c/real.h``).
LANES = ("lanes.h", "lanes_4.c", "lanes_8.c", "steps.c", "wide.h")
#: The code that decides what else is in an FMU.
_GENERATOR = (
    "build/archive.py",
    "build/description.py",
    "build/description2.py",
    "build/description3.py",
    "build/library.py",
    "build/source.py",
    "build/toolchain.py",
    "model/attributes.py",
    "model/declaration.py",
)
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
_TYPE = {
    "real": "IS_REAL",
    "integer": "IS_INTEGER",
    "boolean": "IS_BOOLEAN",
    "size": "IS_SIZE",
}


@lru_cache(maxsize=32)
def sources(model: Model) -> dict[str, str]:
    """Every C file and header of the model's library, by name; compile the ``.c`` files.

    Raises FmuError where a source of the model does not exist or a declaration cannot be.
    """
    files = dict(_written(model))
    files["variables.h"] = _header(model)
    if model.lanes:
        files["lanes_model.h"] = _lanes(model)
    files["variables.c"] = _tables(model, token(model))
    return dict(sorted(files.items()))


@lru_cache(maxsize=32)
def _written(model: Model) -> dict[str, str]:
    """The files of :func:`sources` that are not generated."""
    _check(model)
    files = {name: _read(_FOLDER / name, model) for name in (*_GENERIC, *_HEADERS)}
    if model.lanes:
        files |= {name: _read(_FOLDER / name, model) for name in LANES}
    for source in model.sources:
        path = Path(source) if Path(source).is_absolute() else _FOLDER / source
        files[path.name] = _read(path, model)
    return files


def c_files(model: Model) -> list[str]:
    """The C files to compile, in the order of the alphabet."""
    return [name for name in sources(model) if name.endswith(".c")]


def units(model: Model) -> list[dict[str, str]]:
    """The text of each C file and of the headers that it includes, by name, itself first.

    Where this is equal for two models, they share the object file.
    """
    files = sources(model)
    return [_unit(files, name) for name in files if name.endswith(".c")]


def _unit(files: Mapping[str, str], name: str) -> dict[str, str]:
    found: dict[str, str] = {}
    left = [name]
    while left:
        here = left.pop()
        if here in files and here not in found:
            found[here] = files[here]
            left += _INCLUDE.findall(files[here])
    return found


@lru_cache(maxsize=64)
def token(model: Model) -> str:
    """The GUID (FMI 2.0) and instantiation token (3.0): a hash of declaration and sources."""
    named = replace(model, sources=tuple(Path(source).name for source in model.sources))
    made_from = [asdict(named), sorted(_written(model).items()), _generator()]
    digest = hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).digest()
    return "{" + str(uuid.UUID(bytes=digest[:16])) + "}"


def scalars(variable: Variable) -> Iterator[str]:
    """Names of the scalars, row-major: ``alpha``; ``q[0]``, ``q[1]``; ``xi_in[0,0]`` ..."""
    if not variable.shape:
        yield variable.name
    else:
        for index in product(*map(range, variable.shape)):
            yield f"{variable.name}[{','.join(map(str, index))}]"


def _check(model: Model) -> None:
    """Names are C names and unique, start values as many as entries, dependencies declared."""
    names = [variable.name for variable in model.variables]
    for name in (model.identifier, *(v.symbol or v.name for v in model.variables)):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
            raise FmuError(f"{model.identifier}: {name!r} is not a valid C name")
    for v in model.variables:
        place = f"{model.identifier}.{v.name}"
        if v.name == "time" or names.count(v.name) > 1:
            raise FmuError(f"{place}: declared twice; 'time' is reserved")
        if len(v.starts) != v.size:
            raise FmuError(f"{place}: {len(v.starts)} start values, expected {v.size}")
        for name in (*v.depends, *v.start_depends):
            if name not in names:
                raise FmuError(f"{place}: depends on {name!r}, which is not declared")


def _read(path: Path, model: Model) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise FmuError(f"{model.identifier}: source {path}: {error.strerror}") from error


@lru_cache(maxsize=1)
def _generator() -> str:
    return "".join((_FOLDER.parent / name).read_text(encoding="utf-8") for name in _GENERATOR)


def _layout(model: Model) -> str:
    """Eight bytes that differ where two models do not have the same variables in the same order."""
    entries = [(v.name, v.type, v.shape) for v in model.variables]
    digest = hashlib.sha256(json.dumps([model.identifier, entries]).encode())
    return digest.hexdigest()[:16]


def _inputs(model: Model) -> list[tuple[int, int]]:
    return _ranges(model, lambda v: v.causality == "input")


def _ranges(model: Model, chosen: Callable[[Variable], bool]) -> list[tuple[int, int]]:
    """(first scalar, number of scalars) of each run of `chosen` that lie one after the other."""
    ranges: list[tuple[int, int]] = []
    offset = 0
    for variable in model.variables:
        if chosen(variable):
            if ranges and sum(ranges[-1]) == offset:
                ranges[-1] = (ranges[-1][0], ranges[-1][1] + variable.size)
            else:
                ranges.append((offset, variable.size))
        offset += variable.size
    return ranges


def _header(model: Model) -> str:
    size = sum(v.size for v in model.variables)
    members = "".join(f"    {_member(v)}\n" for v in model.variables)
    macros = "".join(f"#define {name} {value}\n" for name, value in model.defines)
    macros += f"#define STRUCTURAL {model.structural}\n" if model.structural else ""
    macros += "#define EXCHANGE 1 /* model_rates is needed */\n" if model.exchange else ""
    return f"""\
/* variables.h - generated from the declaration of {model.identifier}. */
#ifndef VARIABLES_H
#define VARIABLES_H

{macros}enum {{ N_VARIABLES = {len(model.variables)}, N_SCALARS = {size} }};

struct Model {{
{members}}};

#endif
"""


def _lanes(model: Model) -> str:
    """The file that a step of several instances is compiled from."""
    integers = _ranges(model, lambda v: v.type != "real")
    changed = _ranges(model, lambda v: v.causality in ("output", "local"))
    return f"""\
/* lanes_model.h - generated from the declaration of {model.identifier}. */
#include "{Path(model.sources[0]).name}"

/* What instances that are stepped at once have in common, and what a step may change. */
#define MODEL_INTEGERS {{{", ".join(_entries(integers))}}}
#define MODEL_CHANGED {{{", ".join(_entries(changed))}}}
"""


def _entries(ranges: list[tuple[int, int]]) -> list[str]:
    """Ranges in C; one of no scalars if there are none, since an array needs an entry."""
    return [f"{{{first}, {size}}}" for first, size in ranges or [(0, 0)]]


def _member(variable: Variable) -> str:
    sizes = "".join(f"[{n}]" for n in variable.shape)
    return f"Real {variable.symbol or variable.name}{sizes}; /* {variable.unit} */"


def _access(variable: Variable) -> str:
    bits = [_TYPE[variable.type]]
    if variable.causality == "structuralParameter":
        return bits[0]
    if variable.causality == "parameter":
        bits += ["IS_PARAMETER", "SET_AT_START"]
    elif variable.causality == "input":
        bits += ["SET_AT_START", "SET_IN_STEPS"]
    else:
        bits += ["SET_AT_START" if variable.settable else "IS_CALCULATED"]
    return " | ".join(bits)


def _each(variable: Variable) -> int:
    """Scalars for each unit of the structural parameter; 0 where it does not matter."""
    return 0 if variable.axis < 0 else variable.size // variable.shape[variable.axis]


def _places(model: Model, names: Iterable[str]) -> list[str]:
    """The places of all scalars of some variables."""
    offset, found = 0, {}
    for v in model.variables:
        found[v.name] = [str(offset + k) for k in range(v.size)]
        offset += v.size
    return [place for name in names for place in found[name]]


def _structural(model: Model) -> str:
    """The place of the structural parameter among the scalars."""
    offset = 0
    for variable in model.variables:
        if variable.name == model.structural:
            return str(offset)
        offset += variable.size
    return "N_SCALARS"


def _number(value: float) -> str:
    return {inf: "INFINITY", -inf: "-INFINITY"}.get(value) or repr(float(value))


def _tables(model: Model, token: str) -> str:
    entries, access, starts, names = [], [], [], []
    offset = 0
    for v in model.variables:
        bits = _access(v)
        low = -inf if v.minimum is None else v.minimum
        high = inf if v.maximum is None else v.maximum
        entries.append(
            f'{{"{v.name}", {bits}, {offset}, {v.size}, {_each(v)},'
            f" {_number(low)}, {_number(high)}}}"
        )
        access += [bits] * v.size
        starts += [_number(value) for value in v.starts]
        names += [f'"{name}"' for name in scalars(v)]
        offset += v.size
    entries.append(f'{{"time", IS_REAL, {offset}, 1, 0, -INFINITY, INFINITY}}')
    states = model.states if model.exchange else ()
    state_places = _places(model, (state for state, _ in states))
    rate_places = _places(model, (rate for _, rate in states))
    return "\n".join(
        (
            f"/* variables.c - generated from the declaration of {model.identifier}. */",
            '#include "model.h"\n',
            "typedef char no_padding[sizeof(Model) == N_SCALARS * sizeof(double) ? 1 : -1];\n",
            _table("Declaration declared", _declared(model, token)),
            _table("Variable variables[N_VARIABLES + 1]", entries),
            _table("unsigned char scalar_access[N_SCALARS + 1]", [*access, "IS_REAL"]),
            _table("char *const scalar_names[N_SCALARS + 1]", [*names, '"time"']),
            _table("double start_values[N_SCALARS]", starts),
            _table("Range input_ranges[]", _entries(_inputs(model))),
            _table("unsigned state_places[]", [*state_places, "0"]),
            _table("unsigned rate_places[]", [*rate_places, "0"]),
        )
    )


def _declared(model: Model, token: str) -> list[str]:
    """The members of `Declaration`, in its order."""
    return [
        f'"{model.identifier}", "{token}"',
        f"UINT64_C(0x{_layout(model)})",
        f"N_VARIABLES, N_SCALARS, {len(_inputs(model))}",
        _structural(model),
        f"{int(model.clock > 0.0)}, {_number(model.clock)}",
        "model_steps, model_lanes" if model.lanes else "0, 0",
        "model_rates" if model.exchange else "0",
        str(len(_places(model, (s for s, _ in model.states))) if model.exchange else 0),
    ]


def _table(name: str, entries: list[str]) -> str:
    return f"const {name} = {{\n    " + ",\n    ".join(entries) + "};\n"
