"""Delays that an adversary chooses so that a motion of the linear loop grows.

With all links late by their greatest ages the loop has a slowest mode, of which l . z is the
amplitude (l: its left eigenvector). At each step the adversary takes the ages that make the
amplitude greatest. What it finds is a motion that grows, computed with doubles: a witness, while a
certificate is a proof.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.certify.inequalities import Matrix
from cosim.certify.model import CutLoop

Sequences = NDArray[np.int64]
#: States of the loop with all samples on their way, at most.
_STATES = 700
#: Growth that counts, in each of the last parts of a motion.
_GROWS, _PARTS = 1.05, 4
#: Distance from 1 below which a pole is neutral.
_NEUTRAL = 1e-6


def adversary(loop: CutLoop, steps: int = 4000, seed: int = 0) -> Sequences | None:
    """Ages, (steps, links), in samples, with which a motion grows, or None if none were found.

    None also of a loop that is too large, has feed-through, or sends several times a period.
    """
    n, m = len(loop.A), len(loop.C)
    depth = max(link.most for link in loop.links)
    if n + depth * m > _STATES or loop.D.greatest() or any(x.sends > 1 for x in loop.links):
        return None
    A, B, C = (np.array(x.floats()).reshape(len(x), x.width) for x in (loop.A, loop.B, loop.C))
    mode = _mode(loop, A, B, C, depth)
    if mode is None:
        return None
    own, past = mode[:n], mode[n:].reshape(depth, m)
    x = np.random.default_rng(seed).normal(size=n)
    sent = np.zeros((steps + depth + 1, m))
    sent[: depth + 1] = C @ x
    ages = np.zeros((steps + 1, len(loop.links)), np.int64)
    ages[0] = [link.least for link in loop.links]
    sizes, ends, first = np.zeros(steps), [], 0
    for link in loop.links:
        ends.append(slice(first, first + link.size))
        first += link.size
    through = own @ B
    for k in range(steps):
        now = k + depth
        sent[now] = C @ x
        recent = sent[now : now - depth : -1] if depth else sent[:0]
        total = own @ (A @ x) + (past * recent).sum()
        u = np.zeros(m)
        for i, (link, place) in enumerate(zip(loop.links, ends, strict=True)):
            most = min(link.most, ages[k, i] + 1) if link.ordered and k else link.most
            some = np.arange(link.least, max(most, link.least) + 1)
            gains = total + sent[now - some, place] @ through[place]
            best = int(np.abs(gains).argmax())
            total, ages[k + 1, i], u[place] = gains[best], some[best], sent[now - some[best], place]
        x = A @ x + B @ u
        sizes[k] = abs(total)
        if not 1e-100 < sizes[k] < 1e100:
            scale = max(sizes[k], 1e-300)
            x, sent, sizes = x / scale, sent / scale, sizes / scale
    return ages[1:] if _rises(sizes) else None


def _rises(sizes: Matrix) -> bool:
    """True if the greatest size of each of the last parts is well above that of the one before."""
    parts = [part.max() for part in np.array_split(sizes, 2 * _PARTS)[_PARTS - 1 :]]
    return all(b > _GROWS * a for a, b in pairwise(parts))


def _mode(loop: CutLoop, A: Matrix, B: Matrix, C: Matrix, depth: int) -> Matrix | None:
    """The left eigenvector of the slowest mode that is not neutral, with the greatest ages."""
    n, m = len(A), len(C)
    F = np.zeros((n + depth * m, n + depth * m))
    F[:n, :n] = A
    first = 0
    for link in loop.links:
        for j in range(first, first + link.size):
            if link.most:
                F[:n, n + (link.most - 1) * m + j] += B[:, j]
            else:
                F[:n, :n] += np.outer(B[:, j], C[j])
        first += link.size
    if depth:
        F[n : n + m, :n] = C
        F[n + m :, n:-m] = np.eye((depth - 1) * m)
    values, vectors = np.linalg.eig(F.T)
    size = np.where(np.abs(values - 1.0) < _NEUTRAL, 0.0, np.abs(values))
    return np.asarray(vectors[:, int(size.argmax())]) if size.max(initial=0.0) > 0.0 else None
