"""Libraries that come with an extra of this package, which most runs do without."""

from __future__ import annotations

from importlib.util import find_spec

from cosim.base.errors import ScenarioError

#: By library: the extra that it comes with, and a sentence about what needs it.
_EXTRAS = {
    "PIL": ("figures", "a GIF needs Pillow"),
    "clarabel": ("certify", "a certificate needs Clarabel; to verify one, nothing is needed"),
    "matplotlib": ("figures", "figures need matplotlib; report.html does not"),
}


def require(library: str) -> None:
    """Check that a library is there, before any work. Raises ScenarioError with the command."""
    if find_spec(library) is None:
        extra, need = _EXTRAS[library]
        raise ScenarioError(f"{need}: pip install 'cosim-bridge[{extra}]'")
