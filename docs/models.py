"""The page of all models, from their declarations: ``python docs/models.py`` prints it."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from cosim.base.errors import CosimError  # noqa: E402
from fmus.build.archive import SHIPPED  # noqa: E402
from fmus.model import Model, Variable  # noqa: E402

#: Where the paper has it: H. Wang, "Towards Manipulability of Interactive Lagrangian Systems".
PAPER = {
    "planar2r": "(1), (74), (75), Sec. VII",
    "operator": "Sec. VII",
    "xi": "(47)",
    "teleoperation": "(42)-(45), (61), (76)-(81), Remark 3; Theorems 3, 4, 5",
    "arm_teleoperation": "as teleoperation, for serial arms",
    "arm_task": "as teleoperation, in coordinates of the tip",
    "adaptive": "(29)-(32), Remark 3, Sec. IV-C; Theorem 2",
    "damping": "(24); Theorem 1",
    "pointmass": "(17), (18), Sec. III",
}
HEAD = """\
# Models

Ports, parameters, defaults and equations of every model that comes with an installation.
A scenario names a model as `model = "fmus.models.NAME"` (the FMU),
`"fmus.models.NAME:kernel"` (its C code without FMI) or `"fmus.models.NAME:CLASS"` (the readable
reference in NumPy). The first two give the same bytes, the third the same numbers to 1e-12.
Values are SI. *start* marks outputs whose start value can be set; inputs that nothing feeds keep
their default.
"""


def page() -> str:
    """The whole page."""
    modules = {name: import_module(f"fmus.models.{name}") for name in SHIPPED}
    index = ["| model | | kind | step | in the paper |", "|---|---|---|---|---|"]
    for name, module in modules.items():
        model = module.model()
        index.append(
            f"| [{name}](#{name}) | {model.description} | {model.kind} | {model.step:g} s "
            f"| {PAPER.get(name, '')} |"
        )
    sections = [section(name, module) for name, module in modules.items()]
    return "\n".join([HEAD, *index, "", *sections])


def section(name: str, module: ModuleType) -> str:
    """One model: equations, variables, what its sizes change, presets."""
    model = module.model()
    sizes = {key: p.default for key, p in inspect.signature(module.model).parameters.items()}
    lines = [f"## {name}", "", "```text", (module.__doc__ or "").strip(), "```", ""]
    if sizes:
        said = ", ".join(f"`{key}` (default {int(value)})" for key, value in sizes.items())
        shipped = ", ".join(module.model(**given).identifier for given in SHIPPED[name])
        brought = f"Shipped: {shipped}; others are" if shipped else "It is"
        lines += [f"Sizes: {said}. {brought} built when first used.", ""]
    counted = {key: value for key, value in sizes.items() if not isinstance(value, bool)}
    lines += table(model.variables, counted_shapes(module, model, counted))
    for key in (key for key, value in sizes.items() if isinstance(value, bool)):
        other = module.model(**{key: True})
        same = {row(v) for v in model.variables}
        changed = [v for v in other.variables if row(v) not in same]
        lines += [f"With `{key} = 1` these are added or different:", "", *table(changed, {})]
    lines += of_other_sizes(name, module, counted)
    return "\n".join([*lines, *presets(module)])


def of_other_sizes(name: str, module: ModuleType, counted: Mapping[str, int]) -> list[str]:
    """Variables that only a shipped model of other `counted` sizes has."""
    known, lines = {v.name for v in module.model().variables}, []
    for given in SHIPPED[name]:
        sizes = {key: value for key, value in given.items() if key in counted}
        if new := [v for v in module.model(**sizes).variables if v.name not in known]:
            said = ", ".join(f"`{key} = {value}`" for key, value in sizes.items())
            lines += [f"With {said} these are added:", "", *table(new, {})]
    return lines


def counted_shapes(
    module: ModuleType, model: Model, sizes: Mapping[str, int]
) -> dict[str, tuple[str, ...]]:
    """Shapes in words, of the variables with a dimension that is one of the sizes."""
    found: dict[str, tuple[str, ...]] = {}
    for key, value in sizes.items():
        larger = {v.name: v.shape for v in _neighbour(module, key, value).variables}
        for v in model.variables:
            shape = larger[v.name]
            if len(shape) > len(v.shape):  # rows where there are several
                one = ", ".join(map(str, v.shape))
                found[v.name] = (f"{one}; or {key}, {one}",)
            elif shape != v.shape:
                pairs = zip(v.shape, shape, strict=True)
                found[v.name] = tuple(str(a) if a == b else key for a, b in pairs)
    return found


def _neighbour(module: ModuleType, key: str, value: int) -> Model:
    """The model of the next size, or of the one before where there is none."""
    try:
        return module.model(**{key: value + 1})
    except CosimError:
        return module.model(**{key: value - 1})


def table(variables: Iterable[Variable], shapes: Mapping[str, tuple[str, ...]]) -> list[str]:
    """A table of variables; those that only the library sees are left out."""
    lines = ["| name | | shape | unit | default | |", "|---|---|---|---|---|---|"]
    for v in variables:
        if v.causality == "local":
            continue
        lines.append(row(v, shapes.get(v.name)))
    return [*lines, ""]


def row(v: Variable, shape: tuple[str, ...] | None = None) -> str:
    """A variable as a row of the table; `shape` in words, default: in numbers."""
    sizes = " x ".join(shape or map(str, v.shape))
    settable = v.settable or v.causality in ("input", "parameter")
    causality = f"{v.causality}, start" if v.settable else v.causality
    default = values(v.starts) if settable else ""
    return f"| `{v.name}` | {causality} | {sizes} | {v.unit} | {default} | {described(v)} |"


def described(v: Variable) -> str:
    """What a variable is, and between which limits."""
    limits = [
        f"{sign} {limit:g}"
        for sign, limit in (("≥", v.minimum), ("≤", v.maximum))
        if limit is not None
    ]
    return v.description + (f" ({', '.join(limits)})" if limits else "")


def values(numbers: Iterable[float]) -> str:
    """Numbers as a reader wants them: one where all are equal."""
    listed = tuple(f"{number:g}" for number in numbers)
    return listed[0] if len(set(listed)) == 1 else ", ".join(listed)


def presets(module: ModuleType) -> list[str]:
    """The module's presets, a row each."""
    found = vars(module).get("PRESETS", {})
    if not found:
        return []
    lines = ["| preset | values |", "|---|---|"]
    for name, given in found.items():
        said = "; ".join(f"`{key}` {each(value)}" for key, value in given.items())
        lines.append(f"| {name} | {said} |")
    return [*lines, ""]


def each(value: object) -> str:
    """A preset's value, one number or several."""
    return values(value) if isinstance(value, tuple | list) else str(value)


if __name__ == "__main__":
    print(page())
