"""``network.h``: the networks between the nodes of a twin, as ctypes sees them."""

from __future__ import annotations

import ctypes as c


class NetworkStruct(c.Structure):
    """``network_t``."""

    _fields_ = (
        ("bus", c.c_void_p),
        ("request", c.c_void_p),
        ("advance", c.c_void_p),
        ("next", c.c_void_p),
        ("output", c.c_void_p),
        ("room", c.c_int64),
        ("rx", c.c_void_p),
        ("refused", c.c_void_p),
        ("now_ps", c.c_int64),
        ("n_nodes", c.c_int32),
        ("reserved", c.c_int32),
    )


class RouteStruct(c.Structure):
    """``route_t`` of ``simulated.h``: number of a network, and of a node on it; -1: nowhere."""

    _fields_ = (("network", c.c_int32), ("node", c.c_int32))
