"""The folder of a participant: what is in it, and for which nodes there is none."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import types
from pathlib import Path

import cantools
import numpy as np
import pytest

from bridge.deployment.system import load_system
from bridge.rehearsal.outside import parse
from bridge.sdk import write_participant
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import CONFIGS, TELEOPERATION
from tests.bridge.sdk.bench import needs_cc
from tests.bridge.zenoh.rehearsed import sockets
from tests.cli.command import Command

SHORT = "run.stop=1"


@pytest.fixture
def cosim(monkeypatch, capsys):
    return Command(monkeypatch, capsys)


def lines(path: Path) -> int:
    """Lines of a program without blank ones, comments and its docstring."""
    text = path.read_text(encoding="utf-8").split('"""', 2)[2]
    return sum(1 for line in text.splitlines() if line.strip() and not line.strip().startswith("#"))


def test_the_table_of_a_node_is_that_of_the_dbc_file(tmp_path):
    system = load_system(TELEOPERATION, "can", [SHORT])
    write_participant(system, "slave", "python", tmp_path / "p")
    table = json.loads((tmp_path / "p/table.json").read_text())
    database = cantools.database.load_file(CONFIGS / "can/link_fd2.dbc")
    assert (table["node"], table["number"], table["slots"]) == ("slave", 3, 1000)
    for m in (*table["received"], *table["sent"]):
        theirs = database.get_message_by_name(m["name"])
        assert (m["layout"]["id"], m["layout"]["bytes"]) == (theirs.frame_id, theirs.length)
        signals = [s for s in theirs.signals if re.fullmatch(r"(tau|xi|q|dq)\d", s.name)]
        for ours, signal in zip(m["layout"]["fields"], signals, strict=True):
            found = (ours["start"], ours["bits"], ours["scale"])
            assert found == (signal.start, signal.length, signal.scale)
    page = (tmp_path / "p/README.md").read_text(encoding="utf-8")
    assert "| LINK_4 | right | from slave_control | 0x3A4 FD | 24 | P05 | 13a4 | 5 ms |" in page


@pytest.mark.parametrize("deploy", ["can", "zenoh"])
def test_a_participant_in_python_is_short_and_alone(tmp_path, deploy):
    system = load_system(TELEOPERATION, deploy, [SHORT])
    write_participant(system, "slave", "python", tmp_path / "p")
    for name, most in (("participant.py", 100), ("life.py", 170)):
        program = tmp_path / "p" / name
        assert lines(program) <= most
        assert max(map(len, program.read_text("utf-8").splitlines())) <= 100
        assert not re.search(r"(import|from) (bridge|cosim|fmus)\b", program.read_text("utf-8"))


def life_of(folder: Path) -> types.ModuleType:
    """The module ``life`` of a participant in Python, which leaves the signals of tests alone."""
    found = types.ModuleType("life")
    found.__file__ = str(folder / "life.py")
    text = (folder / "life.py").read_text("utf-8")
    exec(text.replace("signal.signal(ends, self.end)", "pass"), found.__dict__)
    return found


def test_a_controller_in_python_has_no_torque_unless_it_is_active(tmp_path):
    """Torques are limited and scaled: 1 ACTIVE, falling to 0 in the slots of the ramp, then 0."""
    system = load_system(TELEOPERATION, "can", [SHORT])
    write_participant(system, "master_control", "python", tmp_path / "p")
    life = life_of(tmp_path / "p")
    node, ramp = life.Node(8), life.T["ramp_slots"]
    (sent,) = life.T["sent"]
    first, count = sent["torque"]
    node.outputs[sent["name"]][:] = [1e6] * len(sent["values"])
    node.state, node.armed, node.begun, found = life.ACTIVE, True, 1, []
    for k in range(ramp + 2):
        node.raised |= life.ESTOP * (k == 1)
        node.live(1)
        ((_, _, _, values),) = node.samples()
        assert values[first + count :] == [1e6] * (len(values) - first - count)
        found.append((node.state, *values[first : first + count]))
    falls = [(life.STOPPING, *[100.0 * (1 - (k + 1) / ramp)] * 2) for k in range(ramp - 1)]
    expected = [(life.ACTIVE, 100.0, 100.0), *falls, (life.FAULT, 0.0, 0.0), (life.FAULT, 0.0, 0.0)]
    assert np.allclose(found, expected) and not node.armed and node.reasons == life.ESTOP


@needs_cc
def test_the_core_in_c_needs_no_library_and_no_memory(tmp_path):
    system = load_system(TELEOPERATION, "can", [SHORT])
    write_participant(system, "slave_control", "c", tmp_path / "p")
    files = [tmp_path / "p" / name for name in ("participant.c", "protocol.c", "table.c")]
    words = ["cc", "-std=c99", "-O2", "-nostdlib", "-r", "-o", tmp_path / "core.o", *files]
    subprocess.run(words, check=True)
    said = subprocess.run(["nm", "-u", tmp_path / "core.o"], capture_output=True, text=True)
    wanted = {line.split()[-1] for line in said.stdout.splitlines()}
    allowed = {"memcpy", "memset", "memcmp", "strcmp", "snprintf", "__stack_chk_fail"}
    assert wanted - {"_GLOBAL_OFFSET_TABLE_", "__snprintf_chk", "__memcpy_chk"} <= allowed


@pytest.mark.parametrize(
    ("deploy", "node", "language", "text"),
    [
        ("can", "nobody", "c", "found no node 'nobody', expected one of master, slave"),
        ("can", "slave", "java", r"found 'java', expected one of c, c\+\+, python, rust"),
        ("gateway", "left_gateway", "c", "found a gateway, expected a node with components"),
        ("can-damiao", "slave_control", "c", "a message of a drive with its own protocol"),
        ("mixed", "slave_control", "c", "expected one with buses of one kind"),
        ("can-classic", "slave", "python", "expected LINK_n or STATE_n of link_fd.dbc in Python"),
    ],
)  # fmt: skip
def test_a_node_that_no_participant_replaces_is_refused(tmp_path, deploy, node, language, text):
    system = load_system(TELEOPERATION, deploy, [SHORT])
    with pytest.raises(ScenarioError, match=text):
        write_participant(system, node, language, tmp_path / "p")
    assert not (tmp_path / "p").exists()


def test_a_folder_is_not_written_over(tmp_path):
    system = load_system(TELEOPERATION, "can", [SHORT])
    (tmp_path / "p").mkdir()
    (tmp_path / "p/main.c").write_text("mine")
    with pytest.raises(ScenarioError, match="exists already"):
        write_participant(system, "slave", "c", tmp_path / "p")
    assert [path.name for path in (tmp_path / "p").iterdir()] == ["main.c"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["participant", "x"], "expected --scenario FILE --node NODE"),
        (["controller", "x", "--node", "slave"], "are for a participant"),
        (["participant", "x", "--tip", "hand"], "are for an arm"),
        (["plant", "x"], "expected controller, arm or participant"),
    ],
)
def test_options_of_another_kind_are_refused(cosim, words, text):
    assert text in cosim.refused("new", *words)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("nobody=./x", "--outside: found no node 'nobody', expected one of master, slave"),
        ("slave=./x {left}", "found {left}, expected a bus of the node: right"),
        ("slave=./none {right}", "found './none', which cannot be started"),
        ("slave='./x", "No closing quotation"),
    ],
)
def test_a_wrong_program_is_refused(cosim, tmp_path, given, text):
    words = ("rehearse", TELEOPERATION, "--deploy", "can", "-i", "cosim", "--set", SHORT)
    said = cosim.refused(*words, "--no-plot", "--out", tmp_path / "run", "--outside", given)
    assert text in said


def test_simulated_time_has_no_outside(cosim, tmp_path):
    words = (
        "rehearse",
        TELEOPERATION,
        "-i",
        "cosim",
        "--clock",
        "simulated",
        "--outside",
        "slave=x",
    )
    text = "found --outside with the simulated clock"
    assert text in cosim.refused(*words, "--out", tmp_path / "run")


def test_a_program_may_be_started_by_hand():
    system = load_system(TELEOPERATION, "can", [SHORT])
    assert parse(["slave", "master=./m {left}=x"], system) == {
        "slave": "",
        "master": "./m {left}=x",
    }


def test_cosim_tell_understands_a_participant(cosim, tmp_path):
    """Its token is there, and its answers have what ``cosim tell`` needs."""
    changes = [SHORT, "deploy.buses.net.options.wait=9", *sockets(["slave"], tmp_path)]
    system = load_system(TELEOPERATION, "zenoh", changes)
    write_participant(system, "slave", "python", tmp_path / "p")
    words = [sys.executable, tmp_path / "p/participant.py", f"unixsock-stream/{tmp_path}/slave", ""]
    program = subprocess.Popen(words)
    try:
        given = [word for change in changes for word in ("--set", change)]
        said = ("tell", TELEOPERATION, "clock", "--deploy", "zenoh", "--node", "slave", *given)
        for _ in range(50):
            done = cosim(*said)
            if done.code == 0:
                break
            time.sleep(0.2)
        found = json.loads(done.out)["slave"]
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        assert found["host"] == boot and found["running"] is False
        assert {"kept", "error", "date_ns", "run", "origin_ns"} < found.keys()
        assert abs(found["date_ns"] - time.time_ns()) < 60e9
    finally:
        program.kill()
        program.wait()


def test_the_sizes_in_the_header_are_those_that_the_table_is_checked_against():
    from bridge.sdk import c_table

    text = (Path(c_table.__file__).parent / "c/participant.h").read_text(encoding="utf-8")
    for name, most in (
        ("PARTICIPANT_INPUTS", c_table.RECEIVED), ("PARTICIPANT_OUTPUTS", c_table.SENT),
        ("PARTICIPANT_PEERS", c_table.NEIGHBOURS), ("PARTICIPANT_BUSES", c_table.BUSES),
        ("PARTICIPANT_VALUES", c_table.VALUES),
    ):  # fmt: skip
        assert re.search(rf"{name} = {most}\b", text)
