"""Two processes on one host that exchange a vector every 5 ms: our lock-step, HELICS and mosaik.

    python benchmarks/federations.py [--times 2,12] [--rounds N]

Ours are the nodes of configs/teleoperation.toml over Zenoh (TCP on loopback) in lock-step: arms,
controllers, guards and journals are computed, and the signals are those of the twin. The federates
of HELICS (a broker and two cores of type zmq) and the simulators of mosaik (a world and two remote
simulators over TCP) compute nothing: theirs is the exchange alone, by the step of 5 ms that both
wait for. A run of each of two lengths (s), in turns, gives the time of a simulated second without
start and end. HELICS and mosaik: pip install 'cosim-bridge[bench]'.
"""

from __future__ import annotations

import argparse
import importlib
import socket
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, final

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal.hosts import listen_setting
from bridge.rehearsal.settings import Settings
from bridge.rehearsal.supervisor import Rehearsal
from cosim.base.clock import stopwatch

SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml"
NET = "deploy.buses.net.options"
#: The time of an exchange, s, and the names of both sides.
STEP, SIDES = 0.005, ("master", "slave")


def ports(count: int) -> list[int]:
    """Ports of this host that are free now."""
    found = []
    for _ in range(count):
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            found.append(one.getsockname()[1])
    return found


def ours(lookahead: bool, stop: float) -> None:
    """Both nodes in lock-step, from the start of their processes to their end."""
    deployment = spec.find(SCENARIO, "zenoh")
    changes = [
        f"run.stop={stop}", f"{NET}.lockstep=true", f"{NET}.lookahead={str(lookahead).lower()}",
    ]  # fmt: skip
    for node, port in zip(SIDES, ports(2), strict=True):
        changes.append(listen_setting("net", node, f"127.0.0.1:{port}", ("tcp/{}",)))
    system = load_system(SCENARIO, str(deployment), changes)
    settings = replace(Settings(SCENARIO, deployment, tuple(changes)), warm_up=0.0)
    with TemporaryDirectory() as folder, Rehearsal(system, settings, Path(folder, "run")) as run:
        run.run()


# ---- HELICS -------------------------------------------------------------------------------------


def helics(stop: float) -> None:
    """A broker in this process, a federate in each of two."""
    api: Any = importlib.import_module("helics")
    [port] = ports(1)
    broker = api.helicsCreateBroker("zmq", "broker", f"-f 2 --localport={port}")
    command = [sys.executable, __file__, "--federate"]
    sides = [subprocess.Popen([*command, name, str(port), str(stop)]) for name in SIDES]
    for side in sides:
        if side.wait():
            raise RuntimeError("a federate of HELICS has failed")
    api.helicsBrokerDisconnect(broker)
    api.helicsBrokerFree(broker)


def federate(name: str, port: int, stop: float) -> None:
    """One side: publish, wait for the next step, read what the other one has published."""
    api: Any = importlib.import_module("helics")
    info = api.helicsCreateFederateInfo()
    api.helicsFederateInfoSetCoreTypeFromString(info, "zmq")
    api.helicsFederateInfoSetCoreInitString(info, f"-f 1 --brokerport={port}")
    api.helicsFederateInfoSetTimeProperty(info, api.HELICS_PROPERTY_TIME_PERIOD, STEP)
    side = api.helicsCreateValueFederate(name, info)
    kind = api.HELICS_DATA_TYPE_VECTOR
    said = api.helicsFederateRegisterGlobalPublication(side, f"{name}.xi", kind, "")
    other = SIDES[name == SIDES[0]]
    heard = api.helicsFederateRegisterSubscription(side, f"{other}.xi", "")
    api.helicsFederateEnterExecutingMode(side)
    for k in range(round(stop / STEP)):
        api.helicsPublicationPublishVector(said, [float(k), 0.0])
        api.helicsFederateRequestTime(side, (k + 1) * STEP)
        if api.helicsInputGetVector(heard)[0] != k:
            raise RuntimeError(f"{name} has another value than that of step {k}")
    api.helicsFederateDisconnect(side)
    api.helicsFederateFree(side)


# ---- mosaik -------------------------------------------------------------------------------------


def mosaik(stop: float) -> None:
    """A world in this process, a simulator in each of two; values arrive a step later."""
    api: Any = importlib.import_module("mosaik")
    command = f"{sys.executable} {__file__} --simulator %(addr)s"
    world = api.World({"Side": {"cmd": command}}, skip_greetings=True, configure_logging=False)
    master, slave = (world.start("Side", sim_id=name).Side() for name in SIDES)
    first = {"time_shifted": True, "initial_data": {"xi": [-1.0, 0.0]}}
    world.connect(master, slave, ("xi", "xi_in"), **first)
    world.connect(slave, master, ("xi", "xi_in"), **first)
    world.run(until=round(stop / STEP), print_progress=False)


def simulator() -> None:
    """One side, as mosaik starts it; the step is mosaik's unit of time."""
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
            """The number of the step, for the other side."""
            return {"side": {"xi": [float(self._k), 0.0]}}

    sys.argv[1:] = sys.argv[2:]
    api.start_simulation(Side())


# ---- both lengths, in turns ---------------------------------------------------------------------

ENTRANTS: dict[str, Callable[[float], None]] = {
    "lock-step over Zenoh, with look-ahead": partial(ours, True),
    "lock-step over Zenoh, each exchange waited for": partial(ours, False),
    "HELICS, zmq": helics,
    "mosaik, remote simulators": mosaik,
}


def main() -> None:
    """Measure in turns and print the table."""
    if sys.argv[1:2] == ["--simulator"]:
        simulator()
        return
    if sys.argv[1:2] == ["--federate"]:
        federate(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--times", default="2,12", help="lengths of both runs, s")
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    short, long = map(float, asked.times.split(","))
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ENTRANTS}
    for _ in range(asked.rounds):
        for name, run in ENTRANTS.items():
            took = []
            for stop in (short, long):
                watch = stopwatch()
                run(stop)
                took.append(watch())
            seconds[name].append((took[0], took[1]))
    rows = []
    for name, pairs in seconds.items():
        each = median(b - a for a, b in pairs) / (long - short)
        start = median(a for a, _ in pairs) - short * each
        rows.append([name, f"{each:.3f}", f"{1e6 * each * STEP:.0f}", f"{start:.1f}"])
    heads = ["", "s a simulated second", "us an exchange of 5 ms", "start and end, s"]
    print(tables.grid(heads, rows))
    print(tables.machine())


if __name__ == "__main__":
    main()
