"""Generators of random numbers, each from a seed and the name of what it is for.

What is drawn does not depend on the order in which things are listed.
"""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.random import Generator


def entropy(seed: int, name: str) -> bytes:
    """The entropy of a generator: `seed`, and the SHA-256 of the name.

    An array of words is the same entropy as a list of numbers, in half of the time.
    """
    size = max(1, -(-seed.bit_length() // 32)) * 4
    return seed.to_bytes(size, "little") + sha256(name.encode()).digest()


def generator(seed: int, name: str) -> Generator:
    """PCG64, seeded by :func:`entropy`."""
    from numpy.random import PCG64, Generator, SeedSequence  # most runs need none

    words = np.frombuffer(entropy(seed, name), dtype="<u4").astype(np.uint32)
    return Generator(PCG64(SeedSequence(words)))
