"""Unmodified programs in the time of a simulated bus: `cosim bus --clock simulated -- PROGRAM`."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.bus_server.attention import Attention
from bridge.bus_server.program_file import ProgramError, check_program
from bridge.cli.bus import separated
from cosim.bus.timing import frame_bits
from fmus.build.toolchain import compiler
from tests.bridge.bus_server.test_server import COMMAND, ROOT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD is of Linux")

HERE = Path(__file__).parent / "programs"
STEPS = 13


def run(*programs: list[str], options: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    words = list(itertools.chain.from_iterable(["--", *program] for program in programs))
    command = [*COMMAND, "--clock", "simulated", *options, *words]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=200
    )


def python(name: str) -> list[str]:
    return [sys.executable, str(HERE / name)]


def compiled(name: str, folder: Path, *flags: str) -> str:
    output = folder / name
    command = [*compiler(), "-std=gnu99", "-O1", "-o", str(output), str(HERE / f"{name}.c"), *flags]
    subprocess.run([*command, "-lpthread"], check=True)
    return str(output)


@pytest.fixture(scope="module")
def waits(tmp_path_factory: pytest.TempPathFactory) -> str:
    return compiled("waits", tmp_path_factory.mktemp("programs"))


def test_every_wait_of_a_c_program_takes_bus_time(waits: str) -> None:
    done = run([waits])
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    date = 1_767_225_600
    assert lines[0] == f"dates {date * 10**6} {date} {date} 1000000000 1000000000"
    took = {line.split()[0]: line.split()[1:] for line in lines[1:]}
    assert took == {
        "nanosleep": ["0", "1500"], "clock_nanosleep": ["0", "1500"], "sleep": ["0", "2000000"],
        "poll": ["0", "7000"], "ppoll": ["0", "250"], "select": ["0", "2500"],
        "left": ["0", "of", "0", "us"], "pselect": ["0", "3500"], "epoll_wait": ["0", "4000"],
        "pthread_cond_timedwait": ["1", "5000"], "sem_timedwait": ["-1", "6000"],
        "futex": ["-1", "700"], "signalled": ["0", "4000"], "posted": ["0", "4000"],
        "written": ["1", "4000"], "woken": ["0", "4000"], "joined": ["0", "0"],
        "forked": ["7", "2500"], "shelled": ["3", "2500"], "alarmed": ["-1", "1500"],
        "first": ["1", "500"], "expired": ["4", "0"], "next": ["1", "1000"],
        "spun": took["spun"],
    }  # fmt: skip
    assert 3000 <= int(took["spun"][1]) <= 3010


def frames(text: str) -> list[tuple[float, int, bytes]]:
    found = re.findall(r"^(\d+\.\d{7}) ([0-9A-F]{3}) ([0-9a-f]+)$", text, re.MULTILINE)
    date = 1_767_225_600
    return [(float(t) - date, int(i, 16), bytes.fromhex(d)) for t, i, d in found]


def test_iso_tp_keeps_the_separation_time_of_its_receiver() -> None:
    pytest.importorskip("isotp")
    done = run(python("isotp_receiver.py"), python("isotp_sender.py"))
    assert done.returncode == 0, done.stderr
    assert "received 100 bytes" in done.stdout
    sent = [f for f in frames(done.stdout) if f[1] == 0x7E0 and f[2][0] >= 0x20]
    assert len(sent) == STEPS + 1
    starts = [t - (frame_bits(i, d).nominal - 3) / 500e3 for t, i, d in sent]
    gaps = [later - before for before, later in itertools.pairwise(starts)]
    assert gaps == pytest.approx([5e-3] * STEPS, abs=1e-6)


@pytest.fixture
def busy() -> Iterator[None]:
    """Processes that compute beside what is tested."""
    code = "while True: pass"
    burning = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(os.cpu_count() or 1)]
    yield
    for process in burning:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("isotp_receiver.py", "isotp_sender.py"), ("arm_motors.py", "arm_driver.py")]
)
def test_twenty_runs_beside_a_busy_machine_give_the_same_bytes(
    names: tuple[str, ...], busy: None
) -> None:
    pytest.importorskip("isotp")
    found = set()
    for _ in range(20):
        done = run(*map(python, names))
        assert done.returncode == 0, done.stderr
        found.add((done.stdout, done.stderr))
    assert len(found) == 1


def test_canopen_has_heartbeats_and_time_outs_of_the_bus() -> None:
    pytest.importorskip("canopen")
    done = run(python("canopen_node.py"), python("canopen_master.py"))
    assert done.returncode == 0, done.stderr
    assert "value 12345" in done.stdout
    assert "No SDO response received after 0.300" in done.stdout
    beats = done.stdout.splitlines()[-1].split()
    assert beats[0] == "heartbeats"
    assert len(beats) > 5
    assert set(beats[1:]) == {"0.100000"}


def test_a_uds_client_gives_up_after_its_p2_time() -> None:
    pytest.importorskip("udsoncan")
    pytest.importorskip("isotp")
    done = run(python("uds_client.py"))
    assert done.returncode == 0, done.stderr
    assert "answered after 0.030 s" in done.stdout
    assert "no answer after 0.150 s" in done.stdout


def test_the_loop_of_an_arm_has_its_period_and_the_answers_of_this_step() -> None:
    done = run(python("arm_motors.py"), python("arm_driver.py"), options=("--bitrate", "1e6"))
    assert done.returncode == 0, done.stderr
    expected = [f"0.0100 {1 + k / 100:.2f} {2 + k / 100:.2f} {3 + k / 100:.2f}" for k in range(20)]
    assert done.stdout.splitlines() == expected


def test_sockets_of_a_c_program_are_nodes_of_the_bus(tmp_path: Path) -> None:
    done = run([compiled("frames", tmp_path)], options=("--channel", "can0"))
    assert done.returncode == 0, done.stderr
    start, ends = 1_000_000, []
    for identifier, data in ((0x300, b""), (0x101, b""), (0x102, b"\x55" * 8)):
        bits = frame_bits(identifier, data).nominal
        ends.append(start + (bits - 3) * 2000)
        start += bits * 2000
    assert done.stdout.splitlines() == [
        "other -1",
        f"a {ends[0]} 1 300#",
        f"a {ends[1]} 1 101#",
        f"a {ends[2]} 1 102#5555555555555555",
        f"b {ends[2]} 0 102#5555555555555555",
    ]


@pytest.mark.skipif(shutil.which("candump") is None, reason="can-utils")
def test_can_utils_run_on_a_machine_without_can() -> None:
    words = (
        "sleep 0.5; cansend can0 123##1DEADBEEF; sleep 0.1; cangen can0 -g 10 -n 3 -I 42 -L 8 -D i"
    )
    options = ("--channel", "can0", "--fd", "--data-bitrate", "2e6")
    done = run(["candump", "-td", "can0"], ["sh", "-c", f"{words}; sleep 0.1"], options=options)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[2] for line in lines] == ["123", "042", "042", "042"]
    assert lines[0][3:] == ["[04]", "DE", "AD", "BE", "EF"]
    gaps = [float(line[0].strip("()")) for line in lines[2:]]
    assert gaps == pytest.approx([0.01, 0.01], abs=1e-5)  # stuff bits differ


def test_python_can_s_interface_socketcan_runs_unchanged() -> None:
    done = run(python("socketcan.py"), options=("--channel", "can0"))
    assert done.returncode == 0, done.stderr
    bits = frame_bits(0x123, bytes(8)).nominal
    at = 1_767_225_600 + 0.01 + (bits - 3) / 500e3
    assert done.stdout == f"{at:.6f} 123 True\n{at:.6f} 123 False\nno more\n"


def test_programs_of_one_moment_go_on_in_their_order() -> None:
    loop = "for i in 1 2 3; do sleep 0.5; echo {}; done"
    done = run(*(["sh", "-c", loop.format(name)] for name in "abc"))
    assert done.stdout.split() == list("abcabcabc")


CHILDREN = "date -u +%T; sleep 3600; date -u +%T; echo x | (read x; sleep 1; date -u +%T; exit 3)"


@pytest.mark.slow
def test_time_waits_for_children_that_have_not_begun_yet(busy: None) -> None:
    patient = ["taskset", "-c", "0", "nice", "-n", "10"]  # the parent waits before its child runs
    for _ in range(10):
        done = run(["sleep", "100000"], [*patient, "sh", "-c", CHILDREN])
        assert done.stdout.split() == ["00:00:00", "01:00:00", "01:00:01"]


def test_children_live_in_bus_time_and_the_last_program_gives_the_status() -> None:
    done = run(["sleep", "100000"], ["sh", "-c", CHILDREN])
    assert done.returncode == 3
    assert done.stdout.split() == ["00:00:00", "01:00:00", "01:00:01"]


def test_the_bus_ends_at_the_time_that_is_asked_for_and_ends_its_programs() -> None:
    code = "import time\nwhile True: time.sleep(1); print(time.monotonic(), flush=True)"
    options = ("--for", "3.5", "--date", "2030-01-01")
    done = run([sys.executable, "-c", code], options=options)
    assert done.stdout.split() == ["1001.0", "1002.0", "1003.0"]


def test_a_program_that_is_killed_does_not_stop_the_time_of_the_others() -> None:
    code = "import os, time; time.sleep(1); os.kill(os.getpid(), 9)"
    done = run([sys.executable, "-c", code], ["sh", "-c", "sleep 2; date -u +%T"])
    assert done.stdout.split() == ["00:00:02"]
    assert done.returncode == 137


def test_programs_end_with_the_process_that_has_their_time() -> None:
    words = "echo $$; while true; do sleep 1; done"
    command = [*COMMAND, "--clock", "simulated", "--", "sh", "-c", words]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as bus:
        assert bus.stdout is not None
        program = Path("/proc", bus.stdout.readline().strip())
        assert program.exists()
        bus.kill()
        assert bus.stdout.read() == ""  # until the last program has closed it


def test_a_program_that_computes_without_end_is_named() -> None:
    code = "while True: pass"
    done = run([sys.executable, "-c", code], options=("--most-computing", "0.2"))
    assert done.returncode == 2
    assert re.search(r"while True: pass: found thread 1 .*0\.2 s of processor time", done.stderr)
    assert "Traceback" not in done.stderr


def test_a_static_program_is_refused_before_anything_starts(tmp_path: Path) -> None:
    source = tmp_path / "none.c"
    source.write_text("int main(void) { return 0; }\n")
    static = str(tmp_path / "static")
    built = subprocess.run([*compiler(), "-static", "-o", static, str(source)], check=False)
    if built.returncode:
        pytest.skip("no static C library")
    done = run(["touch", str(tmp_path / "started")], [static])
    assert done.returncode == 2
    assert f"{static}: found a static program (no PT_INTERP)" in done.stderr
    assert not (tmp_path / "started").exists()
    script = tmp_path / "script"
    script.write_text(f"#!{static}\n")
    script.chmod(0o755)
    with pytest.raises(ProgramError, match="static program"):
        check_program([str(script)])


def test_programs_that_cannot_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ProgramError, match="found no such program"):
        check_program([str(tmp_path / "none")])
    with pytest.raises(ProgramError, match="found nothing between two --"):
        separated(["a", "--", "--", "b"])
    assert separated(["a", "-x", "--", "b"]) == [["a", "-x"], ["b"]]
    check_program(["sh"])
    own = tmp_path / "setuid"
    own.write_bytes(Path("/bin/sh").read_bytes())
    own.chmod(0o4755)
    check_program([str(own)])
    monkeypatch.setattr(os, "geteuid", lambda: own.stat().st_uid + 1)
    with pytest.raises(ProgramError, match="found a setuid program"):
        check_program([str(own)])


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ((), "expected --clock simulated"),
        (("--clock", "simulated", "--mirror", "vcan0"), "--mirror"),
    ],
)
def test_programs_need_the_simulated_clock_alone(options: tuple[str, ...], text: str) -> None:
    done = subprocess.run(
        [*COMMAND, *options, "--", "true"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_a_server_is_busy_from_before_it_reads_until_it_has_answered() -> None:
    import socket
    import threading

    here, there = socket.socketpair()
    attention = Attention()
    attention.watch(here)
    assert not attention.is_due(())
    there.send(b"x")
    assert attention.is_due(())
    with attention.call(here):
        here.recv(1)
        assert attention.is_due(())
        assert not attention.is_due((threading.get_ident(),))
    assert attention.answered == 1
    assert not attention.is_due(())
    for end in (here, there):
        end.close()
