"""``cosim conform``: options and errors; our own node, judged on simulated buses and over Zenoh."""

import json
import shutil
import socket
import subprocess
import sys

import pytest

from bridge.deployment.system import load_system
from bridge.sdk.folder import write_participant
from tests.bridge.deployments import TELEOPERATION
from tests.bridge.export.rehearsal_with_image import PERIODS
from tests.cli.command import ROOT, Command, finished

NODE = (sys.executable, "-m", "cosim", "node", TELEOPERATION)


@pytest.fixture
def command(monkeypatch, capsys):
    monkeypatch.setenv("NO_COLOR", "1")
    return Command(monkeypatch, capsys)


def test_rules_are_listed(command):
    done = command("conform", "--list", "--rules", "C-40,c-07")
    assert [line.split()[0] for line in done.out.splitlines()] == ["C-07", "C-40"]
    assert "docs/can.md#numbers" in done.out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((), "expected cosim conform SCENARIO --node NODE"),
        ((TELEOPERATION, "--node", "mister"), "master"),
        ((TELEOPERATION, "--node", "master", "--rules", "C-99"), "C-"),
        ((TELEOPERATION, "--node", "master", "-i", "cosim", "--", "./no-such-program"),
         "No such file"),
        ((TELEOPERATION, "--deploy", "gateway", "--node", "left_gateway"), "is a gateway"),
        ((TELEOPERATION, "--deploy", "can-damiao", "--node", "master_control"), "own protocols"),
        ((TELEOPERATION, "--node", "master", "--set", 'deploy.clock="simulated"'), "wall clock"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(command, arguments, text):
    assert text in command.refused("conform", *arguments)


def test_a_program_that_ends_breaks_the_first_rule(command, tmp_path):
    done = command(
        "conform", TELEOPERATION, "--node", "master", "-i", "cosim", "--rules", "C-10,C-40",
        "--junit", tmp_path / "x.xml", "--json", tmp_path / "x.json",
        "--", "sh", "-c", "echo no licence",
    )  # fmt: skip
    assert done.code == 1
    found = {r["rule"]: r for r in json.loads((tmp_path / "x.json").read_text())["rules"]}
    assert found["C-10"]["verdict"] == "failed" and "no licence" in found["C-10"]["came"]
    assert found["C-40"]["verdict"] == "inconclusive"
    assert 'failures="1"' in (tmp_path / "x.xml").read_text()
    assert "verdict: failed" in done.out


def slow(test):
    """A test that judges by all rules, which a busy machine does for minutes."""
    return pytest.mark.slow(pytest.mark.timeout(900)(test))


def judged(path, *arguments):
    """Rules that failed; a slow machine is no reason to fail."""
    done = finished("conform", "--json", path, *arguments, cwd=ROOT, seconds=800.0)
    found = json.loads(path.read_text())
    failed = [f"{r['rule']}: {r['came']}" for r in found["rules"] if r["verdict"] == "failed"]
    assert not failed and done.code in (0, 3), done.out
    return {r["rule"]: r["verdict"] for r in found["rules"]}


@slow
@pytest.mark.parametrize(
    ("node", "buses"), [("master_control", ("left", "right")), ("master", ("left",))]
)
def test_our_own_node_on_simulated_buses(node, buses, tmp_path):
    stop = ("--set", 'run.stop="60 s"')
    channels = [word for bus in buses for word in ("-c", f"{bus}={{{bus}}}")]
    found = judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", node, "-i", "cosim", *stop, "--",
        *NODE, "--node", node, "-i", "cosim", *channels, *stop,
    )  # fmt: skip
    assert found["C-50"] != "not applicable"


def free_ports(count):
    opened = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [s.getsockname()[1] for s in opened]
    for s in opened:
        s.close()
    return ports


def over_zenoh():
    """Options of a kit and of its participant: ports of this machine, and a time-out."""
    ends = zip(("master", "slave"), free_ports(2), strict=True)
    listen = ", ".join(f'{name} = "tcp/127.0.0.1:{port}"' for name, port in ends)
    return ("--deploy", "zenoh", "--set", 'run.stop="60 s"', "--set", 'deploy.silence="0.5 s"',
            "--set", f"deploy.buses.net.options.listen={{ {listen} }}")  # fmt: skip


@slow
def test_our_own_node_over_zenoh(tmp_path):
    same = over_zenoh()
    found = judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", "slave", *same, "--",
        *NODE, "--node", "slave", *same,
    )  # fmt: skip
    assert found["C-50"] != "not applicable"


BOARDS = {
    "native": ("cc",),
    "riscv32": ("riscv64-unknown-elf-gcc", "qemu-system-riscv32"),
}


@slow
@pytest.mark.parametrize("target", BOARDS)
def test_firmware(target, tmp_path):
    for program in ("make", *BOARDS[target]):
        if shutil.which(program) is None:
            pytest.skip(f"no {program}")
    settings = ['run.stop="60 s"', "deploy.latency=false", *(PERIODS if target != "native" else ())]
    same = tuple(word for setting in settings for word in ("--set", setting))
    node = ("--node", "master_control")
    words = (TELEOPERATION, "--deploy", "can", *node, *same)
    done = finished(
        "export", *words, "--firmware", tmp_path / "board", "--target", target, cwd=ROOT
    )
    assert done.code == 0, done
    subprocess.run(["make", "-C", tmp_path / "board"], check=True, capture_output=True)
    found = judged(
        tmp_path / "verdicts.json", *words, "-i", "cosim", "--without", "date,epoch-sent", "--",
        *NODE, *node, *same, "--firmware", tmp_path / "board" / "image.elf",
        "-i", "cosim", "-c", "left={left}", "-c", "right={right}",
    )  # fmt: skip
    assert found["C-16"] == "not applicable" and found["C-50"] != "not applicable"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")
def test_a_participant_in_c_speaks_the_protocol_of_simulated_buses(tmp_path):
    """It is heard, which C-10 fails without."""
    stop, folder = 'run.stop="60 s"', tmp_path / "participant"
    system = load_system(TELEOPERATION, "can", [stop])
    written = write_participant(system, "master_control", "c", folder)
    subprocess.run(written.build, shell=True, cwd=folder, check=True, capture_output=True)
    judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", "master_control", "-i", "cosim",
        "--rules", "C-10", "--set", stop, "--", folder / "participant", "{left}", "{right}",
    )  # fmt: skip


@slow
@pytest.mark.parametrize(("language", "compiler"), [("c++", "c++"), ("rust", "rustc")])
def test_participants_in_other_languages(language, compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    stop, folder = 'run.stop="60 s"', tmp_path / "participant"
    system = load_system(TELEOPERATION, "can", [stop])
    written = write_participant(system, "master_control", language, folder)
    subprocess.run(written.build, shell=True, cwd=folder, check=True, capture_output=True)
    found = judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", "master_control", "-i", "cosim",
        "--set", stop, "--", folder / "participant", "{left}", "{right}",
    )  # fmt: skip
    assert found["C-50"] != "not applicable"


@slow
@pytest.mark.parametrize(
    ("node", "ends"), [("master_control", ("{left}", "{right}")), ("master", ("{left}",))]
)
def test_a_participant_in_python_on_simulated_buses(node, ends, tmp_path):
    stop, folder = 'run.stop="60 s"', tmp_path / "participant"
    write_participant(load_system(TELEOPERATION, "can", [stop]), node, "python", folder)
    found = judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", node, "-i", "cosim",
        "--without", "epoch-sent", "--set", stop, "--",
        sys.executable, folder / "participant.py", "cosim", *ends,
    )  # fmt: skip
    assert found["C-50"] != "not applicable"


@slow
def test_a_participant_in_python_over_zenoh(tmp_path):
    same, folder = over_zenoh(), tmp_path / "participant"
    system = load_system(TELEOPERATION, "zenoh", [x for x in same[2:] if x != "--set"])
    write_participant(system, "slave", "python", folder)
    found = judged(
        tmp_path / "verdicts.json", TELEOPERATION, "--node", "slave", *same,
        "--without", "epoch-sent", "--",
        sys.executable, folder / "participant.py", "{net.listen}", "{net.connect}",
    )  # fmt: skip
    assert found["C-50"] != "not applicable"
