"""Libraries that come with an extra of this package, which most runs do without."""

from __future__ import annotations

from importlib.util import find_spec

from cosim.base.errors import ScenarioError

#: By library: the extra that it comes with, and a sentence about what needs it.
_EXTRAS = {
    "PIL": ("figures", "a GIF needs Pillow"),
    "clarabel": ("certify", "a certificate needs Clarabel; to verify one, nothing is needed"),
    "dpkt": ("recordings", "pcap files need dpkt"),
    "mcap": ("recordings", "MCAP files need mcap"),
    "rosbags": ("recordings", "bags of ROS need rosbags"),
    "wasmtime": ("wasm", "an FMU in WebAssembly needs wasmtime"),
    "matplotlib": ("figures", "figures need matplotlib; report.html does not"),
}


def require(library: str) -> None:
    """Check that a library is there, before any work. Raises ScenarioError with the command."""
    if not is_there(library):
        raise ScenarioError(f"{_EXTRAS[library][1]}: {cure(library)}")


def is_there(library: str) -> bool:
    """True if a library is installed."""
    return find_spec(library) is not None


def cure(library: str) -> str:
    """The command that installs a library."""
    return f"pip install 'cosim-bridge[{_EXTRAS[library][0]}]'"
