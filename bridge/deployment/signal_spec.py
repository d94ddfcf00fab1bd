"""Ranges and rates of signals in a deployment (``[signals]``)."""

from __future__ import annotations

import msgspec

from cosim.base.convert import Number


class SignalSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The allowed values of a signal where it is received, for every entry, in its port's unit.

    `range`: one number: as far on both sides of 0; two: least and greatest. `rate`: greatest change
    in a second; default: the range in 0.1 s, torques of drives in 10 ms.
    :mod:`bridge.deployment.ranges`.
    """

    range: Number | tuple[Number, Number] | None = None
    rate: Number | None = None
