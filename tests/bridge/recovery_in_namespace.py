"""A drive dies, comes back, and the arm is brought back by RESET, ARM, START; run in a namespace.

Started by test_rehearse_faults.py, which makes the namespace; the argument is the run folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bridge.cli.options import BusOptions
from bridge.deployment import spec
from bridge.deployment.system import load_system
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.supervisor import Rehearsal, Settings
from bridge.results.outcome import complete
from tests.bridge.rehearsing import CALM, SCENARIO

ARM = ("slave", "slave_control")


def told(command):
    """Both nodes of the arm are told this."""

    def do(rehearsal):
        for node in ARM:
            rehearsal.current[node].send_command(command)

    return do


EVENTS = (
    ScheduledEvent(0.8, "kill", lambda r: r.kill("slave")),
    ScheduledEvent(1.0, "restart", lambda r: r.restart("slave")),
    ScheduledEvent(5.0, "reset", told("reset")),
    ScheduledEvent(5.5, "again", told("again")),
)


def main(folder):
    path = spec.find(SCENARIO, "can")
    said = (*CALM, "run.stop=7", *BusOptions("udp_multicast").settings(spec.load(path)))
    system = load_system(SCENARIO, str(path), said)
    with Rehearsal(system, Settings(SCENARIO, path, said, events=EVENTS), folder) as rehearsal:
        rehearsal.run()
        rehearsal.end()
        complete(system, folder, rehearsal.ended, {"settings": list(said)}, with_twin=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
