"""Parts that a package uses without knowing them: entry points of installed distributions.

A command is an entry point of the group ``cosim.commands``, named like the command and its
function. What else this distribution has above :mod:`cosim` (the rehearsals of :mod:`bridge`, the
compiler and the models of :mod:`fmus`) is in the group ``cosim.parts``; pyproject.toml lists both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

COMMANDS = "cosim.commands"
PARTS = "cosim.parts"


def part(name: str) -> Any:
    """The module that is the part `name`. Raises ScenarioError where nothing installed has it."""
    from importlib.metadata import entry_points

    for entry in entry_points(group=PARTS, name=name):
        return entry.load()
    from cosim.base.errors import ScenarioError
    from cosim.base.names import unknown

    raise ScenarioError(unknown(name, entry_points(group=PARTS).names, "installed part"))


def commands() -> dict[str, EntryPoint]:
    """The commands that distributions add to those of :mod:`cosim`, by name."""
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=COMMANDS)}
