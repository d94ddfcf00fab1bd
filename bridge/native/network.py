"""``network.h`` and ``simulated_clock.h``: the networks between the nodes of a twin."""

from __future__ import annotations

from bridge.native.structs import NetworkStruct, RouteStruct

__all__ = ["NetworkStruct", "RouteStruct"]
