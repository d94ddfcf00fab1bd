"""Libraries that come with an extra of this package, which most runs do without."""

from __future__ import annotations

from importlib.util import find_spec

from cosim.base.errors import ScenarioError

#: By library: the extra that it comes with, and a sentence about what needs it.
_EXTRAS = {
    "PIL": ("figures", "a GIF needs Pillow"),
    "fmpy": ("fmpy", "the validation of an FMU needs FMPy"),
    "matplotlib": ("figures", "figures need matplotlib; report.html does not"),
}


def install(extra: str) -> str:
    """The command that installs an extra."""
    return f"pip install 'cosim-bridge[{extra}]'"


def missing(library: str) -> str:
    """A sentence with the command that installs a library; empty if it is there."""
    extra, need = _EXTRAS[library]
    return "" if find_spec(library) is not None else f"{need}: {install(extra)}"


def require(library: str) -> None:
    """Check that a library is there, before any work. Raises ScenarioError with the command."""
    if said := missing(library):
        raise ScenarioError(said)
