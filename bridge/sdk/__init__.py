"""Participants: a node of a deployment as a program of its own, in C, C++, Python or Rust.

Input: a deployment and one of its nodes. Output: a folder with sources and the node's tables.
"""

from bridge.sdk.folder import write_participant

__all__ = ["write_participant"]
