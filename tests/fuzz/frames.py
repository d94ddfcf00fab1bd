"""Frames for the decoders and for whole nodes: ``python -m tests.fuzz.frames TARGET LIB …``.

Runs under the sanitizers (see sanitized.py). The seeds are the frames that the nodes of every
shipped deployment send, so they follow the code. Prints how many mutants it has tried, and the s.
"""

from __future__ import annotations

import ctypes as c
import importlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tests.fuzz import mutate
from tests.fuzz.targets import CONFIGS

#: Every shipped deployment of the teleoperator.
DEPLOYMENTS = (
    "can", "can-1khz", "can-classic", "can-damiao", "gateway", "mixed", "zenoh",
)  # fmt: skip
LARGEST = 2**16
#: Slots of a round of one deployment, mutants a slot, part of the frames delivered as they are.
SLOTS, EACH, WELL = 100, 4, 0.8


def use(path: str) -> None:
    """Load this library in place of the installed one."""
    importlib.import_module("bridge.native.library").library_path = lambda: Path(path)


def system_of(name: str):
    from bridge.deployment.system import load_system

    return load_system(CONFIGS / "teleoperation.toml", name, ["run.stop=2.0"])


def mutant(random: np.random.Generator, frame, others) -> object:
    """A frame made of one: other data, length, identifier, flags or time."""
    from bridge.native.frame import DATA, Flags, Frame

    data = frame.payload
    if random.random() < 0.7:
        data = mutate.of_bytes(random, data, [o.payload for o in others])[:DATA]
    made = Frame.of(frame.id, data, frame.flags, frame.t_ns)
    if random.random() < 0.1:
        made.length = int(random.integers(0, LARGEST))
    if random.random() < 0.1:
        made.id = int(random.choice([0, 1, 0x80, 0x700, 0x7FF, 0x1FFFFFFF, 0xFFFFFFFF]))
    if random.random() < 0.2:
        made.flags = int(random.integers(0, 128)) & ~Flags.SENT
    if random.random() < 0.1:
        made.t_ns = int(random.choice([0, -1, 2**62, -(2**62), frame.t_ns + 10**9]))
    return made


# ---- decoders -------------------------------------------------------------------------------


def _encodings() -> Iterator[object]:
    for name in DEPLOYMENTS:
        system = system_of(name)
        yield from (carried.encoding for carried in system.messages.values())
        for service in system.services.values():
            yield from service.heartbeats.values()
            yield from (e for e in (service.sync, service.nmt, service.estop) if e is not None)


def decode(random: np.random.Generator, over: Callable[[int], bool]) -> int:
    """message_decode and e2e_check: values are finite, or untouched."""
    from bridge.native import message as native
    from bridge.native.frame import DATA

    encodings = list(_encodings())
    done = 0
    while not over(done):
        message = encodings[int(random.integers(0, len(encodings)))].message
        values = np.zeros(max(1, message.n_fields))
        frame = native.Frame(t_ns=1)
        native.encode(
            message, values.ctypes.data, native.Header(int(random.integers(0, 256))), frame
        )
        changed = mutant(random, frame, [frame])
        values[:] = 12345.0
        result = native.decode(message, changed, values.ctypes.data, native.Header())
        if result == native.Decoded.OK:
            assert np.isfinite(values[: message.n_fields]).all(), (message.id, changed.payload)
        else:
            assert (values == 12345.0).all(), f"{message.id:#x} wrote values and said {result!r}"
        if changed.length <= DATA:
            native.check(native.E2EProfile(message.e2e), bytes(message.data_ids), changed.payload)
        done += 1
    return done


# ---- nodes ----------------------------------------------------------------------------------


def hear(random: np.random.Generator, over: Callable[[int], bool]) -> int:
    """Whole nodes of each deployment in turn, with mutants among what they hear."""
    done = 0
    while True:
        for name in DEPLOYMENTS:
            with tempfile.TemporaryDirectory() as folder:
                done += _round(random, name, Path(folder), lambda n, base=done: over(base + n))
            if over(done):
                return done


def _round(
    random: np.random.Generator, name: str, folder: Path, over: Callable[[int], bool]
) -> int:
    from bridge.native import node as native
    from bridge.native.frame import Frame
    from bridge.native.library import library
    from bridge.replay import twin

    system = system_of(name)
    slot = library().node_slot
    slot.argtypes = (c.POINTER(native.NodeStruct), c.c_int64, c.c_int64, c.c_uint32)
    pools: dict[str, list[Frame]] = {bus: [] for bus in system.deployment.buses}
    done = 0
    with twin.wired_nodes(system, folder) as nodes:
        for _ in range(SLOTS * len(nodes)):
            if over(done):
                break
            node = min(nodes.values(), key=lambda n: n.struct.slot * n.struct.h_ns)
            now = node.struct.slot * node.struct.h_ns + node.struct.phase_ns
            if node.struct.slot >= node.struct.slots:
                break
            done += _disturb(random, system, node, pools, now)
            if slot(c.byref(node.struct), now, now, 0):
                break  # a component has refused what it was given
            _deliver(random, system, nodes, node, pools, now)
    return done


def _rings(system, node, which: str) -> Iterator[tuple[str, object]]:
    for name, bus in zip(system.buses_of(node.name), node._buses, strict=True):
        yield name, getattr(bus, which)


def _disturb(random, system, node, pools, now: int) -> int:
    done = 0
    for name, ring in _rings(system, node, "rx"):
        for _ in range(EACH if pools[name] else 0):
            pool = pools[name]
            made = mutant(random, pool[int(random.integers(0, len(pool)))], pool[-3:])
            if random.random() < 0.8:
                made.t_ns = now
            ring.put(made)
            done += 1
    return done


def _deliver(random, system, nodes, sender, pools, now: int) -> None:
    """Pass frames of a node to all others on its bus, most of them as they are."""
    from bridge.native.frame import Frame

    for name, ring in _rings(system, sender, "tx"):
        while True:
            frame = Frame()
            if not ring.get(frame):
                break
            frame.t_ns = now
            pools[name] = [*pools[name][-63:], frame]
            for other in nodes.values():
                for bus, its in _rings(system, other, "rx"):
                    if other is not sender and bus == name and random.random() < WELL:
                        its.put(frame)


def main(target: str, path: str, seed: int, count: int, seconds: float) -> None:
    use(path)
    began = 0.0

    def over(done: int) -> bool:
        """True when the time is over, counted from the first call: loading does not count."""
        nonlocal began
        began = began or time.monotonic()
        return time.monotonic() > began + seconds if seconds > 0 else done >= count

    run = {"decode": decode, "hear": hear}[target]
    print(run(np.random.default_rng(seed), over), time.monotonic() - began)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))
