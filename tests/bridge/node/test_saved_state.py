"""Nodes in lock-step that are resumed from a saved state are the twin, to the bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from random import Random
from threading import Barrier, Thread
from typing import Any

import pytest

from bridge.deployment.system import System
from bridge.native.node import FINISHED, STOPPED
from bridge.node import checkpoints
from bridge.node.checkpoints import NodeCheckpoints
from bridge.node.control import Control
from bridge.records.node_lives import Life
from bridge.replay import replay
from tests.bridge.deployments import run_twin
from tests.bridge.node.apart import ARMS, STOP, Network, drawn_link, one, run_apart, system_with


def run_with_states(
    system: System, nodes: Path, resumes: int, times: Sequence[int], seed: int
) -> dict[str, int]:
    """The nodes from a state on, which save another one at each of `times` (ns) but the last, where
    all are killed; how each ended.
    """
    ended: dict[str, int] = {}
    there = Barrier(len(system.nodes))

    def go(name: str, keeping: NodeCheckpoints, control: Control) -> None:
        numbers = range(resumes + 1, resumes + len(times))
        for number, until in zip([-1, *numbers], times, strict=True):
            control.go_on(until, number)
        ended[name] = keeping.run()

    def say(control: Control, event: Mapping[str, Any]) -> None:
        if event.get("t_ns") == times[-1]:
            there.wait()
            control.quit()

    nodes.mkdir(exist_ok=True)
    for name in system.nodes:
        checkpoints.set_aside(nodes, Life(name), ())
    with Network(list(system.nodes), seed, 0.002) as network, ExitStack() as stack:
        threads = []
        for name in system.nodes:
            node = stack.enter_context(one(system, name, network.rings[name], nodes))
            control = Control(node.wired.struct)
            place = checkpoints.place(nodes, Life(name))
            keeping = NodeCheckpoints(
                node, place, control, lambda event, control=control: say(control, event)
            )
            node.struct.until_ns = 0
            if resumes >= 0:
                keeping.resume(resumes)
            threads.append(Thread(target=go, args=(name, keeping, control)))
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return ended


def is_the_twin(system: System, nodes: Path, folder: Path) -> None:
    expected, found = run_twin(system, folder / "twin"), replay.load(nodes)
    run_apart(system, folder / "apart")
    heard, apart = (replay.received_by_life(x) for x in (nodes, folder / "apart"))
    for life in system.nodes:
        assert found[life].tobytes() == expected[life].tobytes(), life
        assert heard[life].tobytes() == apart[life].tobytes(), life


@pytest.mark.parametrize("seed", range(6))
def test_any_links_from_any_time_on_are_the_twin(seed: int, tmp_path: Path) -> None:
    random = Random(seed)
    changes = [*drawn_link(0, random), *drawn_link(1, random)]
    phase = random.choice(["0 ms", "0.3 ms", "2 ms"])
    system = system_with(*changes, f'deploy.nodes.slave.phase="{phase}"')
    last, resumes, end = 0, -1, round(STOP * 1e9)
    for _ in range(3):
        times = sorted(random.randrange(last + 1, end) for _ in range(random.choice((2, 3))))
        ended = run_with_states(system, tmp_path / "nodes", resumes, times, seed)
        assert ended == dict.fromkeys(ARMS, STOPPED), changes
        resumes, last = resumes + len(times) - 1, times[-2]
    times = [2 * end]
    ended = run_with_states(system, tmp_path / "nodes", resumes, times, seed)
    assert ended == dict.fromkeys(ARMS, FINISHED), changes
    is_the_twin(system, tmp_path / "nodes", tmp_path)
