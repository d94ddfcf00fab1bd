"""Nodes in simulated time, one of them computed by an image."""

from __future__ import annotations

import ctypes
import threading
from concurrent.futures import ThreadPoolExecutor

from bridge.bus_server.several_buses import served_buses
from bridge.deployment.spec import load
from bridge.deployment.system import load_system
from bridge.export.firmware import firmware
from bridge.faults.load import load as load_faults
from bridge.native.node import functions
from bridge.native.safety import Command
from bridge.node.handle import SlotImage
from bridge.node.run import NodeOptions, run_node
from bridge.records.node_lives import Life
from tests.bridge.deployments import CONFIGS, TELEOPERATION
from tests.bridge.node.test_simulated_time import on_simulated_buses

NODE = "master_control"
DEPLOY = CONFIGS / "deploy/can.toml"
SETTINGS = ("run.stop=0.1", *on_simulated_buses(load(DEPLOY)))


def system_of(*settings):
    """The deployment on simulated buses, 0.1 s long."""
    return load_system(TELEOPERATION, str(DEPLOY), [*SETTINGS, *settings])


def token_of(system):
    """The token of the tables of the node, hexadecimal."""
    return firmware(system, NODE, "native").token.hex()


def rehearsed(image, folder, script="", *, arm=False):
    """All nodes, each in a thread; reports by node, and the events of the node with the image.

    `arm`: that node is armed once more as soon as it has started.
    """
    system = system_of()
    timings = {name: bus.timing for name, bus in system.deployment.buses.items()}
    nodes, said = folder / "nodes", []
    nodes.mkdir()
    faults = None
    if script:
        (folder / "faults.toml").write_text(script)
        faults = load_faults(folder / "faults.toml")
    token = token_of(system)
    with served_buses(timings, simulated=True) as channels:
        at = [f'deploy.buses.{name}.channel="{where}"' for name, where in channels.items()]
        system = system_of(*at)
        ready, armed = threading.Barrier(len(system.nodes)), threading.Event()

        def run(name):
            def start(control):
                ready.wait(60)
                if arm and name != NODE:
                    armed.wait(60)  # until then no time passes
                control.start(1)
                if arm and name == NODE:
                    functions().node_tell(ctypes.byref(control._struct), Command.ARM)
                    armed.set()

            mine = name == NODE
            chosen = SlotImage(str(image), token) if mine else None
            options = NodeOptions(Life(name), nodes, script=faults, image=chosen)
            return run_node(system, options, said.append if mine else lambda event: None, start)

        with ThreadPoolExecutor(len(system.nodes)) as pool:
            reports = dict(zip(system.nodes, pool.map(run, system.nodes), strict=True))
    return system, nodes, reports, [e for e in said if e["event"] == "fault"]
