"""Options in groups: a parameter of a command that is a dataclass stands for its fields.

A field is declared like a parameter, ``Annotated[TYPE, typer.Option(...)] = DEFAULT``; a list is
``field(default_factory=list)``. So commands share options, and hand them on as one value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def flat(function: Callable[..., None]) -> Callable[..., None]:
    """The command `function` as a library for commands wants it: a parameter for each option."""
    hints = get_type_hints(function, include_extras=True)
    groups = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters = [
        one
        for p in signature(function).parameters.values()
        for one in (
            _options(groups[p.name])
            if p.name in groups
            else [p.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[p.name])]
        )
    ]

    @wraps(function)
    def called(**given: Any) -> None:
        made = {name: _value(kind, given) for name, kind in groups.items()}
        function(**given, **made)

    vars(called).update(__signature__=Signature(parameters), __annotations__={})
    return called


def _options(kind: Any) -> Iterator[Parameter]:
    """The parameters of a group, in the order of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    for f in fields(kind):
        yield Parameter(
            f.name, Parameter.KEYWORD_ONLY, default=_default(f), annotation=hints[f.name]
        )


def _default(f: Field[Any]) -> Any:
    if f.default_factory is not MISSING:
        return None
    return Parameter.empty if f.default is MISSING else f.default


def _value(kind: Any, given: dict[str, Any]) -> Any:
    """The group made of what is `given` for its fields, which is taken out."""
    values: Mapping[str, Any] = {f.name: given.pop(f.name) for f in fields(kind)}
    lists = {f.name for f in fields(kind) if f.default_factory is not MISSING}
    return kind(**{k: v for k, v in values.items() if v is not None or k not in lists})
