"""The names that C files have in common with others when they are linked."""

from __future__ import annotations

import re

_FUNCTION = re.compile(
    r"^(?!typedef|return|else|static)[A-Za-z_][\w \t*]*?[ \t*](\w+)\s*\(", re.MULTILINE
)
_RENAMED = re.compile(r"^#define model_step (\w+)", re.MULTILINE)  # what lanes call their copy
_TABLE = re.compile(r"^extern [\w \t*]*?(\w+)(?:\[\])?;", re.MULTILINE)
_WORDS = {"sizeof", "if", "while", "for", "switch", "__attribute__", "__declspec"}


def linked_names(text: str) -> set[str]:
    """Functions that a file defines, declares or renames, and tables that it declares; static
    functions are not among them.
    """
    return {*_FUNCTION.findall(text), *_RENAMED.findall(text), *_TABLE.findall(text)} - _WORDS


def renamed(names: set[str], prefix: str) -> str:
    """Lines for the preprocessor that put ``prefix_`` before each of `names`."""
    return "".join(f"#define {name} {prefix}_{name}\n" for name in sorted(names))
