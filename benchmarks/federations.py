"""Processes on one host in a ring that exchange a vector every 5 ms: our lock-step, HELICS, mosaik.

    python benchmarks/federations.py [--nodes 2,4,8] [--times 2,12] [--rounds N]

Each receives from the one before it. Ours are the nodes of configs/many.toml over Zenoh (TCP on
loopback) in lock-step: arms, controllers and journals are computed, and the signals are those of
the twin. The federates of HELICS (a broker, and a core of type zmq each) and the simulators of
mosaik (a world, and remote simulators over TCP) compute nothing: theirs is the exchange alone, by
the step of 5 ms that all wait for. A run of each of two lengths (s), in turns, gives the time of a
simulated second without start and end, and its processor time in all processes. HELICS and mosaik:
pip install 'cosim-bridge[bench]'.
"""

from __future__ import annotations

import argparse
import importlib
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, final

from cosim.base.copies import replace

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal.hosts import listen_setting
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import Rehearsal
from cosim.base.clock import stopwatch

SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "many.toml"
NET = "deploy.buses.net.options"
#: The time of an exchange, s.
STEP = 0.005


def ports(count: int) -> list[int]:
    """Ports of this host that are free now."""
    found = []
    for _ in range(count):
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            found.append(one.getsockname()[1])
    return found


def ours(lookahead: bool, count: int, stop: float) -> None:
    """The nodes in lock-step, from the start of their processes to their end."""
    deployment = spec.find(SCENARIO, "many")
    changes = [
        f'graphs.net={{kind="ring", n={count}}}', f"deploy.nodes.node.count={count}",
        f"deploy.messages.xi.count={count}", f"run.stop={stop}",
        f"{NET}.lookahead={str(lookahead).lower()}",
    ]  # fmt: skip
    for i, port in enumerate(ports(count), 1):
        changes.append(listen_setting("net", f"node{i}", f"127.0.0.1:{port}", ("tcp/{}",)))
    system = load_system(SCENARIO, str(deployment), changes)
    settings = replace(Settings(SCENARIO, deployment, tuple(changes)), warm_up=0.0)
    with TemporaryDirectory() as folder, Rehearsal(system, settings, Path(folder, "run")) as run:
        run.run()


# ---- HELICS -------------------------------------------------------------------------------------


def helics(count: int, stop: float) -> None:
    """A broker in this process, a federate in each of the others."""
    api: Any = importlib.import_module("helics")
    [port] = ports(1)
    broker = api.helicsCreateBroker("zmq", "broker", f"-f {count} --localport={port}")
    command = [sys.executable, __file__, "--federate"]
    words = [[str(word) for word in (i, (i - 1) % count, port, stop)] for i in range(count)]
    for side in [subprocess.Popen([*command, *each]) for each in words]:
        if side.wait():
            raise RuntimeError("a federate of HELICS has failed")
    api.helicsBrokerDisconnect(broker)
    api.helicsBrokerFree(broker)


def federate(name: str, before: str, port: int, stop: float) -> None:
    """One of them: publish, wait for the next step, read what the one before has published."""
    api: Any = importlib.import_module("helics")
    info = api.helicsCreateFederateInfo()
    api.helicsFederateInfoSetCoreTypeFromString(info, "zmq")
    api.helicsFederateInfoSetCoreInitString(info, f"-f 1 --brokerport={port}")
    api.helicsFederateInfoSetTimeProperty(info, api.HELICS_PROPERTY_TIME_PERIOD, STEP)
    side = api.helicsCreateValueFederate(name, info)
    kind = api.HELICS_DATA_TYPE_VECTOR
    said = api.helicsFederateRegisterGlobalPublication(side, f"{name}.xi", kind, "")
    heard = api.helicsFederateRegisterSubscription(side, f"{before}.xi", "")
    api.helicsFederateEnterExecutingMode(side)
    for k in range(round(stop / STEP)):
        api.helicsPublicationPublishVector(said, [float(k), 0.0])
        api.helicsFederateRequestTime(side, (k + 1) * STEP)
        if api.helicsInputGetVector(heard)[0] != k:
            raise RuntimeError(f"{name} has another value than that of step {k}")
    api.helicsFederateDisconnect(side)
    api.helicsFederateFree(side)


# ---- mosaik -------------------------------------------------------------------------------------


def mosaik(count: int, stop: float) -> None:
    """A world in this process, a simulator in each of the others; values arrive a step later."""
    api: Any = importlib.import_module("mosaik")
    command = f"{sys.executable} {__file__} --simulator %(addr)s"
    patient = {"start_timeout": 60.0}
    quiet = {"skip_greetings": True, "configure_logging": False}
    world = api.World({"Side": {"cmd": command}}, mosaik_config=patient, **quiet)
    sides = [world.start("Side", sim_id=f"side{i}").Side() for i in range(count)]
    first = {"time_shifted": True, "initial_data": {"xi": [-1.0, 0.0]}}
    for before, side in zip(sides[-1:] + sides, sides, strict=False):
        world.connect(before, side, ("xi", "xi_in"), **first)
    world.run(until=round(stop / STEP), print_progress=False)


def simulator() -> None:
    """One of them, as mosaik starts it; the step is mosaik's unit of time."""
    api: Any = importlib.import_module("mosaik_api_v3")

    @final
    class Side(api.Simulator):  # type: ignore[misc]
        """A simulator that says the number of the step."""

        def __init__(self) -> None:
            model = {"public": True, "params": [], "attrs": ["xi", "xi_in"]}
            super().__init__({"type": "time-based", "models": {"Side": model}})
            self._k = 0

        def create(self, num: int, model: str) -> list[dict[str, Any]]:
            """The one entity."""
            return [{"eid": "side", "type": model}]

        def step(self, time: int, inputs: dict[str, Any], max_advance: int) -> int:
            """One step; what has arrived is of the step before."""
            [(x, _)] = inputs["side"]["xi_in"].values()
            if x != time - 1:
                raise RuntimeError(f"another value than that of step {time - 1}")
            self._k = time
            return time + 1

        def get_data(self, outputs: dict[str, list[str]]) -> dict[str, Any]:
            """The number of the step, for the next one."""
            return {"side": {"xi": [float(self._k), 0.0]}}

    sys.argv[1:] = sys.argv[2:]
    api.start_simulation(Side())


# ---- both lengths, in turns ---------------------------------------------------------------------

ENTRANTS: dict[str, Callable[[int, float], None]] = {
    "lock-step over Zenoh, with look-ahead": partial(ours, True),
    "lock-step over Zenoh, each exchange waited for": partial(ours, False),
    "HELICS, zmq": helics,
    "mosaik, remote simulators": mosaik,
}


def timed(run: Callable[[], None]) -> tuple[float, float]:
    """The wall time and the processor time, s, of a run with all its processes."""
    watch, before = stopwatch(), os.times()
    run()
    return watch(), sum(os.times()[:4]) - sum(before[:4])


def main() -> None:
    """Measure in turns and print the table."""
    if sys.argv[1:2] == ["--simulator"]:
        simulator()
        return
    if sys.argv[1:2] == ["--federate"]:
        name, before, port, stop = sys.argv[2:]
        federate(name, before, int(port), float(stop))
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--nodes", default="2,4,8", help="processes in the ring")
    parser.add_argument("--times", default="2,12", help="lengths of both runs, s")
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    short, long = map(float, asked.times.split(","))
    counts = [int(text) for text in asked.nodes.split(",")]
    cases = [(name, count) for count in counts for name in ENTRANTS]
    seconds: dict[tuple[str, int], list[tuple[float, ...]]] = {case: [] for case in cases}
    for _ in range(asked.rounds):
        for name, count in cases:
            first, last = (timed(partial(ENTRANTS[name], count, stop)) for stop in (short, long))
            seconds[name, count].append((*first, *last))
            took = ", ".join(f"{value:.2f}" for value in (*first, *last))
            print(f"{count} nodes, {name}: {took} s", file=sys.stderr, flush=True)
    rows = []
    for (name, count), found in seconds.items():
        each = median(b - a for a, _, b, _ in found) / (long - short)
        used = median(b - a for _, a, _, b in found) / (long - short)
        start = median(a for a, *_ in found) - short * each
        rows.append(
            [
                name,
                str(count),
                f"{each:.3f}",
                f"{1e6 * each * STEP:.0f}",
                f"{used:.3f}",
                f"{start:.1f}",
            ]
        )
    heads = ["", "nodes", "s a simulated second", "us a step", "processor s", "start and end, s"]
    print(tables.grid(heads, rows))
    print(tables.machine())


if __name__ == "__main__":
    main()
