"""Results of deployments without a wall clock: twins, replays, faults, bus logs, lock-step."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

from bridge.campaign import compressed
from bridge.deployment.system import System, load_system
from bridge.faults.load import build
from bridge.node import lockstep
from bridge.replay import replay
from bridge.results import verdict
from cosim.record import seal
from tests.bridge.replay.test_from_log import logged_twin
from tests.bridge.replay.test_from_log import written as logs_written
from tests.bridge.zenoh import rehearsed
from tests.golden.kept import ROOT, Record
from tests.golden.offline import cosim, say

DEPLOYED = {
    "can": "teleoperation",
    "can-1khz": "teleoperation",
    "can-classic": "teleoperation",
    "can-damiao": "teleoperation",
    "zenoh": "teleoperation",
    "mixed": "teleoperation",
    "gateway": "teleoperation",
    "network": "network",
    "network-can": "network",
}
#: Faults of one script that runs on a simulated clock.
FAULTS = {
    "drop": {"probability": 0.3},
    "corrupt": {"probability": 0.3, "count": 3},
    "delay": {"by": 0.02},
    "duplicate": {"probability": 0.3},
    "forge": {"probability": 0.3, "count": 60},
    "replay": {"count": 100},
    "flood": {"rate": 5000.0},
    "absurd": {"probability": 0.3},
}
STOP = "run.stop=2.0"


def system(name: str, *settings: str) -> System:
    """A shipped deployment, cut."""
    path = ROOT / "configs" / f"{DEPLOYED[name]}.toml"
    return load_system(path, name, [STOP, *settings])


def journals(record: Record, folder: Path, prefix: str) -> None:
    """Keep every slot of every node: times on the simulated clock, states, numbers, signals."""
    for life, rows in replay.load(folder).items():
        record.array(f"{prefix} {life}", rows)


def shipped(record: Record, name: str) -> None:
    """A shipped deployment: checked, run as a twin, replayed and held against an offline run."""
    path = ROOT / "configs" / f"{DEPLOYED[name]}.toml"
    code, out, err = cosim("check", path, "--deploy", name)
    record.measured("check", f"{code}\n{out}\n{err}")
    say(record, "run", "run", path, "--deploy", name, "--set", STOP, "--no-plot", "--out",
        record.folder / "cli")  # fmt: skip
    record.tables(record.folder / "cli", "run ")
    faulty(record, name, {})
    cut = system(name)
    record.text(
        "messages",
        "\n".join(f"{k} {m.bus} {m.node} {m.period_ns}" for k, m in cut.messages.items()),
    )


def faulty(record: Record, name: str, faults: dict[str, dict[str, object]]) -> None:
    """A run with faults on the simulated clock, its folder, its replay and its verdict."""
    cut, folder = system(name), record.folder / "run"
    folder.mkdir()
    tables = [
        {"kind": kind, "node": "slave", "message": "LINK_4", "from": 0.8, "to": 1.3, **values}
        for kind, values in faults.items()
    ]
    script = build({"seed": 1, "fault": tables}, Path("script.toml"))
    outcome = compressed.run(cut, script, folder)
    seal(folder)
    journals(record, folder / "nodes", "journal")
    record.tables(folder)
    for report in sorted((folder / "nodes").glob("*.json")):
        record.document(f"report {report.stem}", json.loads(report.read_text(encoding="utf-8")))
    found = verdict.judge(cut, outcome)
    record.text("verdict", f"{found.word} {found.exit_code}\n{found.text()}")
    record.text("faults", "\n".join(f"{f.verdict}: {f.text()}" for f in outcome.faults))
    _looked_at(record, folder)


def _looked_at(record: Record, folder: Path) -> None:
    code, out, _ = cosim("replay", folder)
    lines = [x for x in out.splitlines() if not x.startswith("time ")]
    record.text("replay", f"{code}\n" + "\n".join(lines))
    code, out, err = cosim("replay", folder, "--offline")
    record.measured("replay --offline", f"{code}\n{out}\n{err}")
    code, out, err = cosim("monitor", folder, "--once")
    record.measured("monitor", f"{code}\n{out}\n{err}")


def log(record: Record) -> None:
    """A bus log of a twin, and its controllers run again on it."""
    from pytest import MonkeyPatch

    cut = system("can")
    with MonkeyPatch.context() as patch:
        logs = logged_twin(cut, record.folder, patch)
    for bus, rows in logs.items():
        record.array(f"frames on {bus}", rows)
    paths = logs_written(logs, record.folder)
    for path in paths:
        record.text(path.name, path.read_text(encoding="utf-8"))
    scenario = ROOT / "configs" / "teleoperation.toml"
    code, out, err = cosim(
        "replay", "--from-log", paths[0], "--scenario", scenario, "--deploy", "can"
    )
    record.measured("replay --from-log", f"{code}\n{out}\n{err}")


def in_lockstep(record: Record) -> None:
    """Nodes as processes, in lock-step over Zenoh: no clock, so that it is the same every time."""
    nodes = ("master", "slave")
    changes = [
        STOP, "deploy.buses.net.options.lockstep=true", 'deploy.buses.net.options.wait="20 s"',
        *rehearsed.sockets(nodes, record.folder),
    ]  # fmt: skip
    cut, running = rehearsed.prepared("teleoperation", "zenoh", changes, record.folder / "run")
    assert lockstep.is_lockstep(cut)
    with running:
        ended = running.run()
    found = rehearsed.collect(cut, ended, record.folder / "run")
    for life, rows in found.rows.items():
        record.array(f"journal {life}", rows)
    record.numbers("difference of the replay", [found.replayed.greatest])


CASES = {
    **{f"deploy {name}": partial(shipped, name=name) for name in DEPLOYED},
    **{
        f"fault {kind}": partial(faulty, name="can", faults={kind: v}) for kind, v in FAULTS.items()
    },
    "bus log": log,
    "lock-step": in_lockstep,
}
