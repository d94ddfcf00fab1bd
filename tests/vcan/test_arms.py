"""Arms of several motors on SocketCAN: rehearsals, and the command for hardware."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from bridge.can.log import read_log
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from tests.system.your_own_arm import commands, prepared
from tests.vcan.peers import call
from tests.vcan.rehearsals import CALM, NODES, ROOT, cosim, running, said, settings

SECONDS = 3
PERIOD = [f'components.{n}.period="5 ms"' for n in NODES]


def soft(gain: float) -> list[str]:
    """Late torque destabilises an arm whose gain is large for its inertia; these stand 80 ms."""
    return [f"components.{n}.parameters.K={gain}" for n in NODES[2:]]


def rehearsed(scenario: Path, link: str, folder: Path, *changes: str) -> Path:
    """The run folder of a rehearsal on vcan0, vcan1 and a third bus, which replayed exactly."""
    run = folder / "run"
    words = settings(*CALM, *PERIOD, *changes, f'run.stop="{SECONDS} s"')
    words += ["-c", f"link={link}", "--no-plot", "--out", str(run)]
    done = cosim(folder / "lib", "rehearse", str(scenario), *words)
    assert done.returncode in (0, 3), done.stdout + done.stderr  # 3: this machine was too slow
    assert "difference exactly 0" in done.stdout
    for node in NODES:
        slots = Journal.open(run / "nodes" / f"{node}.journal")["slot"]
        assert slots.tolist() == list(range(SECONDS * 200))
    return run


@pytest.mark.usefixtures("vcan")
def test_two_openarms_of_seven_motors_on_can_fd(fresh_bus: str, tmp_path: Path) -> None:
    run = rehearsed(ROOT / "configs" / "openarm.toml", fresh_bus, tmp_path, *soft(0.04))
    for bus in ("left", "right"):
        rows = read_log(run / "buses" / f"{bus}.log").rows
        assert set(rows["id"].tolist()) == {base + n for base in (0x00, 0x10) for n in range(1, 8)}
        assert (rows["flags"] & (Flags.FD | Flags.BRS) == Flags.FD | Flags.BRS).all()
        assert len(rows) >= 14 * SECONDS * 200


@pytest.mark.usefixtures("vcan")
def test_the_arms_of_the_page_on_classic_can(fresh_bus: str, tmp_path: Path) -> None:
    run = rehearsed(prepared(tmp_path) / "arm.toml", fresh_bus, tmp_path, *soft(0.4))
    rows = read_log(run / "buses" / "left.log").rows
    assert set(rows["id"].tolist()) == {1, 2, 3, 0x11, 0x12, 0x13}
    assert not (rows["flags"] & Flags.FD).any()
    done = cosim(tmp_path / "lib", "replay", str(run))
    assert done.returncode == 0 and "exactly 0 in every signal" in done.stdout


@pytest.fixture
def can_interfaces() -> Iterator[None]:
    """Interfaces with the names of real ones."""
    for name in ("can0", "can1"):
        call("ip", "link", "add", "dev", name, "type", "vcan")
        call("ip", "link", "set", name, "up")
    yield
    for name in ("can0", "can1"):
        call("ip", "link", "del", "dev", name, check=False)


def hardware(arm: Path) -> list[str]:
    """The page's command for hardware, with its files in `arm`."""
    (line,) = commands("hardware")
    return [*line.replace("arm.toml", str(arm / "arm.toml")).split()[1:], "--yes"]


@pytest.mark.usefixtures("can_interfaces")
def test_the_command_for_hardware_ends_where_no_drive_answers(
    fresh_bus: str, tmp_path: Path
) -> None:
    words = hardware(prepared(tmp_path))
    done = cosim(tmp_path / "lib", *words, "-c", f"link={fresh_bus}")
    assert done.returncode == 1
    assert "error: drive 1 on bus left did not answer with its TIMEOUT (9)" in done.stderr


class Registers:
    """Answers of Damiao drives to those who write and read registers, on one interface."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(interface="socketcan", channel=channel)
        self.values: dict[int, bytes] = {}
        self.modes: list[tuple[int, int]] = []  # drives, and the last byte of FF FF ... FC
        self.notifier = can.Notifier(self.bus, [self.answer])

    def answer(self, message: can.Message) -> None:
        if message.data[:7] == bytes([255] * 7):
            self.modes.append((message.arbitration_id, message.data[7]))
        if message.arbitration_id != 0x7FF:
            return
        node, what = message.data[0], message.data[2]
        if what == 0x55:
            self.values[node] = bytes(message.data[4:])
        data = bytes([node, 0, what, 9]) + self.values.get(node, bytes(4))
        self.bus.send(can.Message(0, 0x10 + node, is_extended_id=False, data=data))

    def __enter__(self) -> Registers:
        return self

    def __exit__(self, *_: object) -> None:
        self.notifier.stop()
        self.bus.shutdown()


@pytest.mark.usefixtures("can_interfaces")
def test_the_command_for_hardware_runs_with_drives_that_answer(
    fresh_bus: str, tmp_path: Path
) -> None:
    """The arms are other processes with emulated drives, of which the command knows nothing."""
    arm, run = prepared(tmp_path), tmp_path / "run"
    calm = settings(*CALM, *PERIOD, *soft(0.4))
    drives = [str(arm / "arm.toml"), "--deploy", "hardware", "--now", *calm]
    words = [*hardware(arm), *calm, *settings(f'run.stop="{SECONDS} s"'), "-c", f"link={fresh_bus}"]
    with ExitStack() as stack:
        registers = [stack.enter_context(Registers(channel)) for channel in ("can0", "can1")]
        for n, node in enumerate(NODES[:2]):
            out = str(tmp_path / node)
            lib = tmp_path / f"lib{n}"
            one = running(lib, "node", *drives, "--node", node, "--out", out)
            said(stack.enter_context(one), "ready, starting")
        done = cosim(tmp_path / "lib", "rehearse", *words[1:], "--out", str(run))
    assert done.returncode in (0, 3), done.stdout + done.stderr
    assert "together         not computed: slave.q, master.q, of a node" in done.stdout
    assert "difference exactly 0" in done.stdout
    for one in registers:
        timeouts = {n: 50e-6 * int.from_bytes(v, "little") for n, v in one.values.items()}
        assert timeouts == pytest.approx({n: 0.05 for n in (1, 2, 3)})
        assert one.modes[:6] == [(n, what) for n in (1, 2, 3) for what in (0xFB, 0xFC)]
        assert {what for _, what in one.modes[6:]} == {0xFD}
    rows = read_log(run / "buses" / "left.log").rows
    torques = [r["data"].tobytes()[:8] for r in rows if r["id"] == 2]
    assert len(set(torques)) > 20  # gravity of the arm that moves
    for node in NODES[2:]:
        slots = Journal.open(run / "nodes" / f"{node}.journal")["slot"]
        assert slots.tolist() == list(range(SECONDS * 200))
