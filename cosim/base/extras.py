"""Libraries that come with an extra of this package, which most runs do without."""

from __future__ import annotations

from importlib.util import find_spec

from cosim.base.errors import ScenarioError

#: The command that installs the libraries of figures, matplotlib and Pillow.
FIGURES = "pip install 'cosim-bridge[figures]'"


def require_matplotlib() -> None:
    """Check that figures can be drawn, before work is done for them.

    Raises ScenarioError with the command that installs matplotlib if it is missing.
    """
    if find_spec("matplotlib") is None:
        raise ScenarioError(
            f"figures need matplotlib, which is not installed: {FIGURES}; report.html needs nothing"
        )
