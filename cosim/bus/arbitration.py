"""Arbitration on one CAN bus: the most urgent waiting frame is sent, without interruption.

The arbitration compares the frames bit by bit, and a dominant bit wins. A node takes part with its
most urgent frame or with its oldest request, as with the default queue of Linux and with many USB
adapters.

Source: Bosch, CAN Specification 2.0 (1991), part B, bitwise arbitration; ISO 11898-1:2015.
"""

from __future__ import annotations


def rank(identifier: int, extended: bool = False, remote: bool = False) -> int:
    """The bits that arbitrate as a number of 32 bits; the smallest wins.

    A data frame beats a remote one of the same identifier, an 11-bit identifier a 29-bit one that
    begins with it.
    """
    if extended:
        return (identifier >> 18) << 21 | 3 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return identifier << 21 | remote << 20
