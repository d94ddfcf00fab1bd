"""Mutants of a target's inputs, each tried once: what was tried and what was found."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.base.errors import CosimError
from tests.fuzz import sanitized
from tests.fuzz.targets import TARGETS, Target

#: s after which an input counts as one that hangs its reader.
HANG = 20.0
#: Findings after which a target is left.
MOST = 5
#: The folder for mutants: on a busy disk, writing them takes most of the time. None: the usual one.
IN_MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


class Hang(BaseException):
    """A reader that does not come to an end."""


@dataclass(frozen=True)
class Finding:
    """An input that a reader did not refuse as it has to; `what`: the error, or the report."""

    target: str
    what: str
    suffix: str = ""
    data: bytes = b""


@dataclass(frozen=True)
class Fuzzed:
    """The number of mutants tried in so many `seconds`, and the findings."""

    tried: int
    findings: tuple[Finding, ...]
    seconds: float = 0.0

    @property
    def rate(self) -> str:
        """Mutants a minute, in words; "": not known."""
        return f", {60 * self.tried / self.seconds:.0f} a minute" if self.seconds > 0 else ""


def names() -> tuple[str, ...]:
    """All targets."""
    return (*sanitized.TARGETS, *TARGETS)


def fuzz(name: str, seed: int, count: int = 0, seconds: float = 0.0) -> Fuzzed:
    """Try `count` mutants, or as many as fit into `seconds`; the same seed makes the same."""
    if name in sanitized.TARGETS:
        return _in_child(name, seed, count, seconds)
    target = TARGETS[name]
    random = np.random.default_rng(seed)
    found: list[Finding] = []
    tried, known = 0, set[str]()

    def take(data: bytes, suffix: str) -> None:
        error = attempt(target, data, suffix)
        place = error.rpartition("File ")[2]
        if error and place not in known:
            known.add(place)
            found.append(Finding(name, error, suffix, data))

    with _quiet():
        seeds = target.seeds()
        for suffix, data in seeds:  # what reading imports, and compiles once, does not count
            take(data, suffix)
        begin = time.monotonic()
        end = begin + seconds
        while len(found) < MOST and (time.monotonic() < end if seconds > 0 else tried < count):
            suffix, data = seeds[int(random.integers(0, len(seeds)))]
            take(target.mutate(random, data, [d for s, d in seeds if s == suffix]), suffix)
            tried += 1
    return Fuzzed(tried, tuple(found), time.monotonic() - begin)


def attempt(target: Target, data: bytes, suffix: str) -> str:
    """Read one input: "" where it was read or refused, else the traceback."""
    # models that a text names are compiled once, into the cache of the user
    cache = _cache_in if target.fills_cache else nullcontext
    place = tempfile.TemporaryDirectory(prefix="fuzz-", dir=IN_MEMORY)
    with place as scratch, cache(scratch):
        try:
            with _limited(), target.written(data, suffix, Path(scratch)) as path:
                target.read(path)
        except CosimError:
            return ""
        except (Hang, Exception):
            return traceback.format_exc()
    return ""


def _in_child(name: str, seed: int, count: int, seconds: float) -> Fuzzed:
    words, environment = sanitized.command(name, seed, count, seconds)
    try:
        done = subprocess.run(
            words, env=environment, capture_output=True, text=True, timeout=seconds + 300
        )
    except subprocess.TimeoutExpired as error:
        return Fuzzed(0, (Finding(name, f"hangs: {error}"),))
    if done.returncode:
        return Fuzzed(0, (Finding(name, f"exit code {done.returncode}\n{done.stderr[-6000:]}"),))
    tried, took = done.stdout.split()[-2:]
    return Fuzzed(int(tried), (), float(took))


@contextmanager
def _limited() -> Iterator[None]:
    """Raise Hang after HANG s of processor time, or of waiting ten times as long."""

    def late(*_: object) -> None:
        raise Hang(f"still at it after {HANG:g} s")

    timers = (
        (signal.SIGPROF, signal.ITIMER_PROF, HANG),
        (signal.SIGALRM, signal.ITIMER_REAL, 10 * HANG),
    )
    before = [signal.signal(number, late) for number, _, _ in timers]
    for _, timer, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


@contextmanager
def _cache_in(folder: str) -> Iterator[None]:
    """Archives are unpacked into this folder, not into the user's cache."""
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = folder
    try:
        yield
    finally:
        if before is None:
            del os.environ["XDG_CACHE_HOME"]
        else:
            os.environ["XDG_CACHE_HOME"] = before


@contextmanager
def _quiet() -> Iterator[None]:
    """Numbers out of range are what is looked for, and warned of by NumPy."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield
