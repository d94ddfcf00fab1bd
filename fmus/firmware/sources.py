"""A model in two files: a header with its variables, and all of its code.

The code is that of the FMU without the FMI layer (:mod:`fmus.build.source`): the same text, in one
file, with its names behind that of the model. It needs no C library.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from cosim.base.copies import replace
from cosim.base.errors import FmuError
from fmus.build.source import sources, token
from fmus.firmware.names import linked_names, renamed
from fmus.model import Model, Variable

#: Files of the boards, the check, and what replaces a C library.
FOLDER = Path(__file__).parents[1] / "c" / "firmware"
#: Headers that a compiler without a C library has, and those that ``library.h`` replaces.
_FREESTANDING = {"float.h", "iso646.h", "limits.h", "stdbool.h", "stddef.h", "stdint.h"}
_REPLACED = {"math.h", "string.h"}
_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*[<"]([^>"]+)[>"]', re.MULTILINE)
_DIRECTIVE = re.compile(r"[ \t]*#[ \t]*[a-z]+")
_ONE, _SEVERAL, _UNSURE = "one instance", "several instances", "unsure"
_CONTENT = "#include <stddef.h>\n#include <stdint.h>\n\n"


def files(model: Model) -> dict[str, str]:
    """``NAME.h`` and ``NAME.c``. Raises FmuError for a source that needs a C library."""
    if model.structural:
        raise FmuError(
            f"{model.identifier} has any number of {model.structural}; expected a fixed one,"
            f" such as --set {model.structural}=2: firmware allocates no memory"
        )
    return {f"{model.identifier}.h": header(model), f"{model.identifier}.c": code(model)}


def header(model: Model) -> str:
    """The declaration of the variables and of the functions."""
    name, guard = model.identifier, f"FIRMWARE_{model.identifier.upper()}_H"
    members = "".join(f"    {_member(v)}\n" for v in model.variables)
    return f"""\
/* {name}.h - {_comment(model.description)}.
 *
 * Generated from the sources of the FMU {token(model)}.
 * Numbers are double, also integers and Booleans (0 or 1), in the units of the FMU.
 */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

#define {name}_STEP {model.step!r} /* s, the usual step */

typedef struct {{
{members}}} {name}_t;

/* All start values, and the outputs that follow from them. NULL, or a message about a value. */
const char *{name}_init({name}_t *x);

/* The outputs at the start again, after parameters, start values or inputs were changed. */
const char *{name}_start({name}_t *x);

/* One step h > 0 from the time t, both in s. NULL, or a message; then nothing has changed. */
const char *{name}_step({name}_t *x, double t, double h);

#ifdef __cplusplus
}}
#endif

#endif
"""


def _member(v: Variable) -> str:
    sizes = "".join(f"[{n}]" for n in v.shape)
    kind = "" if v.type == "real" else f" {v.type},"
    text = f"{v.causality},{kind} {v.unit}"
    if v.description:
        text += f": {v.description}"
    return f"double {v.symbol or v.name}{sizes}; /* {_comment(text)} */"


def _comment(text: str) -> str:
    return " ".join(text.split()).replace("*/", "* /")


def code(model: Model) -> str:
    """The code of a model in one file. Raises FmuError for a source that needs a C library."""
    alone = replace(model, lanes=False)
    texts = {
        name: text.replace(token(alone), token(model))
        for name, text in sources(alone).items()
        if name != "variables.h"
    }
    own = [Path(source).name for source in model.sources if source.endswith(".c")]
    compiled = ["kernel.c", "variables.c", *own]
    texts["contact.h"] = texts.get("contact.h") or _shipped("../contact.h")
    texts["library.h"] = _shipped("library.h")
    if "contact.c" not in compiled:
        texts["contact.c"] = _shipped("../contact.c")
        compiled += ["contact.c"] if _calls_root(texts, own) else []
    return _joined(model, texts, compiled)


def _shipped(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _joined(model: Model, texts: Mapping[str, str], compiled: list[str]) -> str:
    """The files `compiled` one after the other, with each header where it is needed first."""
    name = model.identifier
    seen = {"variables.h"}
    parts = [
        _expanded(file, texts, seen, model)
        for file in ("contact.h", "library.h", "declaration.h", *compiled)
    ]
    body = "".join(parts).replace(
        "typedef struct Model Model;", f"typedef {name}_t Model;\n\n{_constants(model)}"
    )
    return f"""\
/* {name}.c - {_comment(model.description)}.
 *
 * Generated: the files of the FMU {token(model)} without FMI, in one file.
 */
#include "{name}.h"

{_CONTENT}{renamed(linked_names(body), name)}
{body}
/* --- the functions of {name}.h --- */

const char *{name}_init({name}_t *x)
{{
    kernel_reset((double *)x);
    return kernel_initial((double *)x);
}}

const char *{name}_start({name}_t *x) {{ return kernel_initial((double *)x); }}

const char *{name}_step({name}_t *x, double t, double h)
{{
    return kernel_step((double *)x, t, h);
}}
"""


def _constants(model: Model) -> str:
    """The macros and sizes that ``variables.h`` has besides the struct."""
    size = sum(v.size for v in model.variables)
    macros = "".join(f"#define {name} {value}\n" for name, value in model.defines)
    return f"{macros}enum {{ N_VARIABLES = {len(model.variables)}, N_SCALARS = {size} }};"


def _expanded(name: str, texts: Mapping[str, str], seen: set[str], model: Model) -> str:
    """A file with the headers that it includes in their places, but none of `seen`, to which they
    are added. What is for several instances at once (``real.h``) is left out.
    """
    if name in seen:
        return ""
    seen.add(name)
    found, inside = [f"/* --- {name} --- */\n"], list[str]()
    for line in texts[name].splitlines(keepends=True):
        word = (_DIRECTIVE.match(line) or [""])[0].replace(" ", "")
        if word.startswith("#if"):
            inside.append(_condition(line))
        ours = bool(inside) and inside[-1] in (_ONE, _SEVERAL)
        if word == "#else" and ours:
            inside[-1] = _SEVERAL
        elif _SEVERAL in inside or (ours and word in ("#if", "#endif")):
            pass
        elif word == "#include":
            sure = all(kind != "other" for kind in inside)
            found.append(_included(line, name, texts, seen if sure else {*seen, _UNSURE}, model))
        else:
            found.append(line)
        if word == "#endif":
            inside.pop()
    return "".join(found) + "\n"


def _condition(line: str) -> str:
    """The kind of an #if: the guard of a header, one that is decided here, or another."""
    if line.strip() == "#if TOGETHER == 1":
        return _ONE
    return "guard" if re.match(r"\s*#\s*ifndef \w+_H\s*$", line) else "other"


def _included(line: str, name: str, texts: Mapping[str, str], seen: set[str], model: Model) -> str:
    """The header of an #include, or the line; ``_UNSURE in seen``: in a condition, maybe false."""
    found = _INCLUDE.match(line)
    header = found[1] if found else line
    if f'"{header}"' in line:
        if header in texts or header in seen:
            return _expanded(header, texts, seen, model)
        if _UNSURE in seen:
            return line
    elif header in _FREESTANDING or name == "library.h":
        return line
    elif header in _REPLACED:
        return ""
    known = ", ".join(f"<{known}>" for known in sorted(_FREESTANDING | _REPLACED))
    raise FmuError(
        f"{model.identifier}: {name} includes {line.split(maxsplit=1)[1].strip()}; expected a file"
        f" of the model, or one of {known}: firmware has no C library"
    )


def _calls_root(texts: Mapping[str, str], own: list[str]) -> bool:
    """True where a source of the model, or a header that it includes, calls sqrt."""
    left, found = [*own], set[str]()
    while left:
        here = left.pop()
        if here in texts and here not in found:
            found.add(here)
            left += _INCLUDE.findall(texts[here])
    return any(re.search(r"\bsqrt\s*\(", texts[name]) for name in found)
