"""``cosim rehearse --firmware`` and ``cosim node --firmware`` as a user runs them."""

from __future__ import annotations

import ctypes
import json
import re
import signal
import subprocess

import can
import pytest

from bridge.can.threaded import to_frame
from bridge.native.message import Decoded, Header, decode
from bridge.native.safety import LifeState
from bridge.simulated_can.bus import CosimBus
from cosim.base.clock import monotonic_ns
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.firmware.running import NODE, system_of
from tests.cli.command import CALL, ROOT, Command


@pytest.fixture
def cosim(monkeypatch, capsys):
    return Command(monkeypatch, capsys)


def words(folder, *more):
    head = ("rehearse", TELEOPERATION, "--deploy", "can", "-i", "cosim", "--out", folder / "run")
    return (*head, "--set", "run.stop=0.1", "--no-plot", *more)


SIMULATED = ("--clock", "simulated")


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (("--firmware", "image.elf"), "expected NODE=IMAGE, with one of master, slave, master_con"),
        (("--firmware", "nobody=image.elf"), "expected NODE=IMAGE, with one of master, slave"),
        (("--firmware", f"{NODE}=none.elf"), "none.elf: No such file or directory; expected an im"),
        (("--firmware", f"{NODE}={TELEOPERATION}"), "found no ELF file; expected an image (ELF)"),
    ],
)
def test_what_is_no_image_of_a_node_is_refused(cosim, more, text, tmp_path):
    assert text in cosim.refused(*words(tmp_path, *SIMULATED, *more))
    assert not (tmp_path / "run").exists()


def test_on_the_wall_clock_the_cure_is_said(cosim, tmp_path):
    said = cosim.refused(*words(tmp_path, "--firmware", f"{NODE}=image.elf"))
    assert "found the wall clock, expected --clock simulated, with -i cosim" in said
    assert "cosim node --firmware" in said


def test_an_image_of_another_run_is_refused_before_the_start(cosim, native, tmp_path):
    more = ("--firmware", f"{NODE}={native}", "--set", "run.stop=0.2")
    said = cosim.refused(*words(tmp_path, *SIMULATED, *more))
    assert "found 20 slots of another length of the run, expected 40" in said
    assert "cosim export" in said
    more = ("--firmware", f"{NODE}={native}", "--set", f"deploy.nodes.{NODE}.guard.tau_max=50")
    said = cosim.refused(*words(tmp_path, *SIMULATED, *more))
    assert "of another deployment or version, expected" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ('kind = "drop"', "found drop of frames with the simulated clock, expected kill, restart"),
        (
            'kind = "kill"\nat = 0.05\nnode = "slave"',
            "found kill of slave with the simulated clock",
        ),
    ],
)
def test_other_faults_are_refused_in_simulated_time(cosim, native, table, text, tmp_path):
    (tmp_path / "faults.toml").write_text(f"[[fault]]\n{table}\n")
    more = ("--firmware", f"{NODE}={native}", "--faults", tmp_path / "faults.toml")
    assert text in cosim.refused(*words(tmp_path, *SIMULATED, *more))


def test_noise_needs_an_image(cosim, tmp_path):
    (tmp_path / "faults.toml").write_text(
        f'[[fault]]\nkind = "noise"\nat = 0.05\nnode = "{NODE}"\n'
    )
    said = cosim.refused(*words(tmp_path, "--faults", tmp_path / "faults.toml"))
    assert "noise needs a node with --firmware" in said


@pytest.mark.slow
def test_a_rehearsal_says_which_node_was_firmware_and_replays(cosim, native, tmp_path):
    more = ("--firmware", f"{NODE}={native}", "--plot")
    done = cosim(*words(tmp_path, *SIMULATED, *more))
    assert done.code == 0, done
    assert f"{NODE}: {native} on this machine, SHA-256 " in done.out
    assert "positions differ by 0 rad RMS" in done.out
    assert "every node finished, no slot missed, replays exactly" in done.out
    assert cosim("replay", tmp_path / "run").code == 0
    facts = json.loads((tmp_path / "run/run.json").read_text("utf-8"))["rehearsal"]["nodes"]
    assert facts[NODE]["said"]["firmware"]["image"] == str(native)
    assert str(native) in (tmp_path / "run/report.html").read_text("utf-8")


@pytest.mark.slow
def test_the_verdict_names_what_happened_to_an_emulator(cosim, native, tmp_path):
    (tmp_path / "faults.toml").write_text(f'[[fault]]\nkind = "kill"\nat = 0.05\nnode = "{NODE}"\n')
    more = ("--firmware", f"{NODE}={native}", "--faults", tmp_path / "faults.toml", "--no-twin")
    done = cosim(*words(tmp_path, *SIMULATED, *more))
    assert done.code == 1, done
    why = f"the image of node {NODE} ended by signal 9 in slot 10 (t = 0.05 s)"
    assert f"t = 0.050 s: kill {NODE}" in done.out
    assert f"t = 0.050 s: node {NODE} has ended: {why}" in done.out
    assert f"kill on {NODE}, 0.05 s, 1 x: {NODE}: {NODE} has ended" in done.out
    verdict = done.out[done.out.index("verdict") :]
    assert "failed: " in verdict and why in verdict
    assert "difference exactly 0" in done.out


# ---- on the wall clock ----


PATIENCE = 60.0


def life_told(bus, beat):
    """Wait for a heartbeat, and return its state."""
    values = (ctypes.c_double * beat.n_fields)()
    end = monotonic_ns() + round(PATIENCE * 1e9)
    while monotonic_ns() < end:
        message = bus.recv(1.0)
        if message is None or message.arbitration_id != beat.id:
            continue
        assert decode(beat, to_frame(message, 0), values, Header()) is Decoded.OK
        return LifeState(int(values[0]))
    raise AssertionError("no heartbeat")


def test_an_image_is_a_node_on_the_buses_of_the_wall_clock(native, tmp_path):
    """Its frames go both ways, until a signal ends it."""
    wire = ("--bitrate", "1000000", "--fd", "--data-bitrate", "5000000")
    serving = subprocess.Popen(
        [*CALL, "bus", "--channel", "x", *wire, "--listen", str(tmp_path / "bus")],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert serving.stdout is not None
    assert "cosim" in serving.stdout.readline()
    place = f"x@{tmp_path / 'bus'}"
    ends = ("-i", "cosim", "-c", f"left={place}", "-c", f"right={place}")
    which = ("--deploy", "can", "--node", NODE, "--firmware", str(native))
    node = subprocess.Popen(
        [*CALL, "node", str(TELEOPERATION), *which, "--set", "run.stop=0.1", *ends],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    beat = system_of().services["left"].heartbeats[2].message
    bus = CosimBus(place, receive_own_messages=False)
    try:
        assert life_told(bus, beat) is LifeState.INACTIVE
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\2\2"))  # NMT: stop
        assert life_told(bus, beat) is LifeState.INACTIVE
    finally:
        bus.shutdown()
        node.send_signal(signal.SIGTERM)
        out = node.communicate(timeout=PATIENCE)[0]
        serving.terminate()
        serving.communicate(timeout=PATIENCE)
    assert f"{NODE}: ready on this machine, waiting for NMT start" in out
    assert re.search(r"^received +[1-9][0-9]* frames$", out, re.M), out
    assert re.search(r"^sent +[1-9][0-9]* frames$", out, re.M), out
    assert node.returncode == 128 + signal.SIGTERM
