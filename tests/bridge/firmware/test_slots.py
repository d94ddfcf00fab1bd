"""A node whose slots an image computes is the twin's node, to the bit; what goes wrong is named."""

from __future__ import annotations

import os
import signal

import pytest

from bridge.firmware import emulator as emulators
from bridge.firmware.emulator import Emulator, Patience
from bridge.firmware.records import FirmwareError
from bridge.native.safety import Command
from bridge.records.node_lives import Life
from bridge.replay import replay
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.firmware import double
from tests.bridge.firmware.running import DEPLOY, NODE, SETTINGS, rehearsed, system_of, token_of
from tests.bridge.node.test_simulated_time import compared


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """A shorter patience with images that do not answer."""
    monkeypatch.setattr(emulators, "IDLE_LOOKS", (10, 30))


def doubled(tmp_path, **lies):
    token = bytes.fromhex(token_of(system_of()))
    return double.written(tmp_path, TELEOPERATION, DEPLOY, SETTINGS, NODE, token, **lies)


def failed(image, tmp_path, script=""):
    """The report of the node, whose image has failed; the others have come to their end."""
    system, nodes, reports, faults = rehearsed(image, tmp_path, script)
    ends = {name: report.end.value for name, report in reports.items()}
    assert ends == dict.fromkeys(system.nodes, "finished") | {NODE: "failed"}
    if replay.load(nodes):
        recorded = replay.load(nodes), replay.received_by_life(nodes)
        (tmp_path / "replay").mkdir()
        assert replay.replay(system, *recorded, tmp_path / "replay").first is None
    return reports[NODE], faults


def test_a_native_image_is_the_node_of_the_twin(native, tmp_path):
    system, nodes, reports, _ = rehearsed(native, tmp_path)
    compared(system, nodes, tmp_path)
    report = reports[NODE]
    assert report.firmware["machine"] == "this machine"
    assert report.sent["LINK_2"]["frames"] == reports["master"].messages["LINK_2"]["ok"] == 20
    assert report.messages["STATE_1"]["ok"] > 10


def test_an_image_in_qemu_is_the_node_of_the_twin(cortex_m4, tmp_path):
    system, nodes, reports, _ = rehearsed(cortex_m4, tmp_path)
    compared(system, nodes, tmp_path)
    assert reports[NODE].firmware["machine"] == "mps2-an386 (Cortex-M4)"


def test_a_double_is_the_node_of_the_twin_too(tmp_path):
    system, nodes, _, _ = rehearsed(doubled(tmp_path), tmp_path)
    compared(system, nodes, tmp_path)


def test_a_command_reaches_the_image(native, tmp_path):
    """It is in a row that it writes."""
    system, nodes, _, _ = rehearsed(native, tmp_path, arm=True)
    rows = replay.load(nodes)[Life(NODE)]
    assert [int(commands) for commands in rows["commands"] if commands] == [Command.ARM]
    recorded = replay.load(nodes), replay.received_by_life(nodes)
    (tmp_path / "replay").mkdir()
    assert replay.replay(system, *recorded, tmp_path / "replay").first is None


def test_the_replay_names_the_slot_in_which_an_image_computes_something_else(tmp_path):
    image = doubled(tmp_path, at=7, does="other")
    system, nodes, _, _ = rehearsed(image, tmp_path)
    (tmp_path / "replay").mkdir()
    recorded = replay.load(nodes), replay.received_by_life(nodes)
    found = replay.replay(system, *recorded, tmp_path / "replay").first
    assert found is not None
    assert (found.life.node, found.slot) == (NODE, 7)


@pytest.mark.parametrize(
    ("lie", "text"),
    [
        ("missing", "has answered with slot 7 and 0 rows, expected one row"),
        ("ahead", "has answered with slot 8 and 1 rows, expected one row"),
        ("short", "has sent a row of "),
        ("text", "has sent 6 bytes that belong to no record"),
        ("fails", "failed with result 7: no solution"),
        ("exit", "ended with exit status 1: assertion failed"),
        ("mute", "does not answer, and waits"),
    ],
)
def test_what_an_image_does_wrong_is_named_with_its_slot(lie, text, tmp_path):
    report, _ = failed(doubled(tmp_path, at=7, does=lie), tmp_path)
    assert report.error.startswith(f"the image of node {NODE} {text}")
    assert report.error.endswith("in slot 7 (t = 0.035 s)")
    assert report.slots == 7


@pytest.mark.parametrize(
    ("kind", "keys", "text"),
    [
        ("kill", "", "ended by signal 9"),
        ("freeze", "for = 1", "is stopped"),
        ("restart", "", "has restarted"),
        ("noise", "count = 5", "has sent 5 bytes that belong to no record"),
    ],
)
@pytest.mark.parametrize("image", ["native", pytest.param("cortex_m4", marks=pytest.mark.slow)])
def test_faults_of_an_image_are_named_with_their_slot(kind, keys, text, image, request, tmp_path):
    script = f'[[fault]]\nkind = "{kind}"\nnode = "{NODE}"\nat = "52 ms"\n{keys}\n'
    path = request.getfixturevalue(image)
    report, faults = failed(path, tmp_path, script)
    what = "image" if image == "native" else "emulator"
    assert report.error.startswith(f"the {what} of node {NODE} {text} in slot 1")
    (fault,) = faults
    assert (fault["action"], fault["target"]) == ("kill" if kind == "restart" else kind, NODE)
    assert fault["t"] == pytest.approx(0.055)  # slot 11, the first one at 52 ms or later
    assert report.slots in ((11, 12) if kind == "restart" else (11,))  # QEMU resets when it likes


@pytest.mark.parametrize(
    ("hello", "text"),
    [
        ({"version": 2}, "found records of version 2, expected 1; export the node again"),
        ({"number": 3}, r"found node master_control \(number 3\), expected master_control \(num"),
        ({"name": "slave"}, r"found node slave \(number 2\), expected master_control"),
        (
            {"row": 8, "h_ns": 1},
            "found rows of 8 instead of [0-9]+, a slot of 1 instead of 5000000",
        ),
        ({"slots": 21}, "found 21 slots of another length of the run, expected 20"),
        ({"token": b"\1" * 16}, f"found the tables {'01' * 16} of another deployment or version"),
    ],
)
def test_another_image_is_refused_before_the_start(hello, text, tmp_path):
    from bridge.firmware.slots import check

    system = system_of()
    token = bytes.fromhex(token_of(system))
    image = double.written(
        tmp_path, TELEOPERATION, DEPLOY, SETTINGS, NODE, token,
        hello={k: v.hex() if isinstance(v, bytes) else v for k, v in hello.items()},
    )  # fmt: skip
    with pytest.raises(ScenarioError, match=text):
        check(system, NODE, Emulator(image, NODE), token)


def test_a_program_that_is_silent_is_refused_before_the_start(tmp_path):
    from bridge.firmware.slots import check

    image = tmp_path / "image"
    image.write_text("#!/bin/sh\nexec sleep 60\n")
    image.chmod(0o755)
    emulator = Emulator(image, NODE)
    with pytest.raises(FirmwareError, match="does not answer, and waits; expected a hello"):
        check(system_of(), NODE, emulator, bytes(16))
    with pytest.raises(ProcessLookupError):
        os.kill(emulator.pid, 0)


def test_a_process_that_computes_has_time_and_one_that_computes_too_long_has_not(
    tmp_path, monkeypatch
):
    """Progress is its own processor time: that of the wall may be as long as it likes."""
    image = tmp_path / "image"
    image.write_text("#!/bin/sh\nwhile :; do :; done\n")
    image.chmod(0o755)
    monkeypatch.setattr(emulators, "BUSY", (0.1, 0.3))
    with Emulator(image, NODE) as emulator:
        patience = Patience(emulator)
        while not (why := patience.look()):
            assert emulator.receive() == b""
        assert why == "has computed for 0 s without an answer"
        assert patience.doubtful
        emulator.send_signal(signal.SIGSTOP)
        patience = Patience(emulator)
        while not (why := patience.look()):
            assert emulator.receive() == b""
        assert why == "is stopped"
