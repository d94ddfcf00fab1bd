"""The launcher of a kernel with CAN; slow: the kernel itself, and all of tests/vcan on it."""

from __future__ import annotations

import mmap
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bridge.vcan import capabilities, cpus, packages
from bridge.vcan.__main__ import main
from bridge.vcan.errors import VcanError
from bridge.vcan.guest import GuestCommand, command_script, kernel_command, write
from bridge.vcan.packages import GuestFiles
from bridge.vcan.supervise import as_status, descendants, status_of

ROOT = Path(__file__).resolve().parents[3]
LAUNCH = [sys.executable, "-m", "bridge.vcan", "run"]
PATIENCE = 120.0  # s
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="CAN sockets are Linux only")


@pytest.fixture
def kernel() -> None:
    """A host that can have a kernel with CAN; in CI it must."""
    found = (capabilities.host(), capabilities.uml())
    if any(ability.possible for ability in found):
        return
    why = "; ".join(f"{ability.backend}: {ability.why}" for ability in found)
    (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(f"no kernel with CAN: {why}")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(packages.VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


# ---- without starting anything ----


def test_a_script_becomes_the_command_with_environment_folder_and_umask(tmp_path: Path) -> None:
    odd = tmp_path / "a 'b' $c"
    odd.mkdir()
    says = "import os,sys; print(os.getcwd(), os.environ['X Y'], os.umask(0), sys.argv[1:])"
    command = [sys.executable, "-c", says, "", "$HOME", "a'b\n"]
    before = os.umask(0o027)
    script = command_script(command, {"X Y": "1 $2 'ä'\n", "PATH": os.environ["PATH"]}, odd)
    os.umask(before)
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True)
    assert done.stdout == f"{odd} 1 $2 'ä'\n {0o027} ['', '$HOME', \"a'b\\n\"]\n"


def test_what_a_guest_could_not_do_is_refused(tmp_path: Path) -> None:
    with pytest.raises(VcanError, match="without '='"):
        command_script(["A=1", "true"], {}, tmp_path)
    with pytest.raises(VcanError, match="its own /dev"):
        command_script(["true"], {}, Path("/dev/shm"))
    parts = GuestFiles(tmp_path / "linux", Path("/a b/busybox"), ())
    with pytest.raises(VcanError, match="/a b/busybox"):
        kernel_command(tmp_path, GuestCommand(("true",)), parts, (3, 4, 5, 6))


def test_settings_are_shell(tmp_path: Path) -> None:
    parts = GuestFiles(
        tmp_path, tmp_path / "b", ((Path("/m/can.ko"), ""), (Path("/v.ko"), "echo=1"))
    )
    write(tmp_path, GuestCommand(("true",), buses=3), parts)
    show = f'. {tmp_path}/settings; printf "%s|" "$busybox" "$buses" "$modules"'
    done = subprocess.run(["sh", "-c", show], capture_output=True, text=True)
    assert done.stdout == f"{tmp_path}/b|3|/m/can.ko\n/v.ko echo=1|"


def test_the_idlest_cpu_first() -> None:
    before = cpus.idle_ticks("cpu 9 9 9 9 9\ncpu0 1 0 1 100 5 0\ncpu1 1 0 1 100 5 0\nintr 1\n")
    after = cpus.idle_ticks("cpu0 1 0 1 101 5 0\ncpu1 1 0 1 105 6 0\n")
    assert before == {0: 105, 1: 105}
    assert cpus.by_idleness({0, 1}, before, after) == [1, 0]
    assert cpus.by_idleness({0, 2}, before, after) == [0, 2]


def test_two_guests_take_two_cpus(tmp_path: Path) -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one CPU")
    (first, held), (second, also) = cpus.choose(tmp_path), cpus.choose(tmp_path)
    assert first != second and held and also
    held.close()
    also.close()


@pytest.mark.parametrize(("text", "size"), [("64K", 65536), ("512M", 2**29), ("1G", 2**30)])
def test_sizes(text: str, size: int) -> None:
    assert capabilities.bytes_of(text) == size


def test_memory_goes_where_there_is_room() -> None:
    assert capabilities.memory_folder(4096).is_dir()
    with pytest.raises(VcanError, match="too little space"):
        capabilities.memory_folder(2**60)


def test_exit_statuses() -> None:
    assert [as_status(code) for code in (0, 3, -9)] == [0, 3, 137]
    assert status_of(None, 7) == 7 and status_of(None, None) is None
    assert status_of(signal.SIGALRM, 7) == 124
    assert status_of(signal.SIGINT, 7) == 7 and status_of(signal.SIGINT, None) == 130


def test_descendants_are_found() -> None:
    child = subprocess.Popen(["sh", "-c", "sleep 30 & wait"])
    try:
        end = time.monotonic() + PATIENCE
        while len(descendants(child.pid)) < 1:
            assert time.monotonic() < end
        grandchild = descendants(child.pid)[0]
        assert {child.pid, grandchild} <= set(descendants(os.getpid()))
    finally:
        os.kill(grandchild, signal.SIGKILL)
        child.wait()


@pytest.mark.parametrize("arguments", [["--mem", "lots"], ["--mem", "1G"]])
def test_a_wrong_call_is_a_sentence(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["true"] if arguments[1] == "lots" else []
    assert main(["run", *arguments, "--", *command]) == 125
    assert capsys.readouterr().err.startswith("error: ")


def test_without_apt_it_says_what_is_missing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(VcanError, match=r"apt-get was not found.*user-mode-linux"):
        packages.obtain()
    assert not capabilities.uml().possible and "apt-get is missing" in capabilities.uml().why


def test_without_lists_of_packages_it_says_how_to_get_them(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("apt-get", "dpkg-deb"):
        program = tmp_path / name
        program.write_text("#!/bin/sh\necho 'E: Unable to locate package' >&2\nexit 100\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(VcanError, match=r"Unable to locate package.*apt-get update"):
        packages.obtain()
    assert sorted(path.name for path in cache.iterdir()) == ["lock"]


# ---- with a kernel ----


def launched(
    *words: str, timeout: float = PATIENCE, mem: str = "1G"
) -> subprocess.CompletedProcess[bytes]:
    command = [*LAUNCH, "--timeout", str(timeout), "--mem", mem, "--", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, timeout=timeout + PATIENCE)


@pytest.fixture
def running(kernel: None) -> Iterator[subprocess.Popen[bytes]]:
    """A command that runs until SIGTERM or SIGINT, and says so."""
    says = "trap 'echo INT; exit 7' INT; trap 'echo TERM; exit 8' TERM; echo ready; sleep 99 & wait"
    command = [*LAUNCH, "--timeout", str(PATIENCE), "--", "sh", "-c", says]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout and process.stdout.readline() == b"ready\n"
    yield process
    process.kill()
    process.communicate()


def opened_folders(pids: list[int]) -> set[Path]:
    """Folders of launchers in which these processes have files open; others run beside them."""
    files = [file for pid in pids for file in Path(f"/proc/{pid}/fd").glob("*")]
    opened = {Path(os.readlink(file)).parent for file in files if file.is_symlink()}
    return opened & set(packages.cache().resolve().glob("run-*"))


def gone(pids: list[int]) -> bool:
    """Whether these processes end."""
    end = time.monotonic() + PATIENCE
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


@pytest.mark.slow
def test_status_output_and_errors_are_the_commands_own(kernel: None) -> None:
    says = "head -c 300000 /dev/zero; echo no >&2; exit 3"
    done = launched("sh", "-c", says)
    assert (done.returncode, len(done.stdout), done.stderr) == (3, 300000, b"no\n")
    done = launched("sh", "-c", "kill -9 $$")
    assert (done.returncode, done.stdout, done.stderr) == (137, b"", b"")
    assert launched("no-such-command").returncode == 127


@pytest.mark.slow
def test_a_time_out_ends_the_command(kernel: None) -> None:
    done = launched("sleep", "1000", timeout=6)
    assert (done.returncode, done.stdout) == (124, b"")


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 7), (signal.SIGTERM, 8)])
def test_signals_reach_the_command(
    running: subprocess.Popen[bytes], number: signal.Signals, status: int
) -> None:
    processes = descendants(running.pid)
    running.send_signal(number)
    said = running.communicate(timeout=PATIENCE)[0]
    assert (running.returncode, said) == (status, number.name[3:].encode() + b"\n")
    assert gone(processes)


@pytest.mark.slow
def test_nothing_stays_when_the_launcher_is_killed(running: subprocess.Popen[bytes]) -> None:
    processes = descendants(running.pid)
    folders = opened_folders([running.pid, *processes])
    assert len(processes) > 1 and folders
    running.kill()
    assert gone(processes)
    assert not any(folder.exists() for folder in folders)


@pytest.mark.slow
def test_the_run_ends_when_nobody_reads(kernel: None) -> None:
    command = [*LAUNCH, "--timeout", str(PATIENCE), "--", "yes"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout and process.stdout.read(4) == b"y\ny\n"
    process.stdout.close()
    assert process.wait(PATIENCE) == 141


@pytest.mark.slow
def test_a_mapped_file_of_a_killed_writer_is_there_on_the_host(
    kernel: None, tmp_path: Path
) -> None:
    path = tmp_path / "journal"
    path.write_bytes(bytes(mmap.PAGESIZE))
    says = (
        "import mmap, os, struct, sys; m = mmap.mmap(os.open(sys.argv[1], os.O_RDWR), 4096)\n"
        "struct.pack_into('<Q', m, 8, 12345); os.kill(os.getpid(), 9)"
    )
    assert launched(sys.executable, "-c", says, str(path)).returncode == 137
    assert struct.unpack_from("<Q", path.read_bytes(), 8) == (12345,)


@pytest.mark.slow
def test_inside_the_kernel_is_the_hosts_own(kernel: None) -> None:
    """A second launcher inside the first finds CAN there, and uses it."""
    inner = "test $(ls /proc/sys/net/ipv4/conf | grep -c '^vcan') = 3 && exit 6"
    done = launched(*LAUNCH, "--backend", "host", "--buses", "3", "--", "sh", "-c", inner)
    assert (done.returncode, done.stderr) == (6, b"")


#: Time limit of all tests that need CAN, on the one slow processor of the guest, s.
WHOLE = 1200


def passes_on_a_kernel_with_can(tmp_path: Path, least: int, *selection: str) -> None:
    """These tests pass on such a kernel, at least so many, and none is skipped."""
    report = tmp_path / "report.xml"
    options = ("-q", "-m", "", "-p", "no:cacheprovider", f"--junitxml={report}")
    words = (sys.executable, "-m", "pytest", *options, *selection)
    done = launched(*words, timeout=WHOLE, mem="2G")  # six nodes, and the tests before them
    said = done.stdout.decode()[-8000:] + done.stderr.decode()[-2000:]
    assert done.returncode == 0, said
    suite = next(ElementTree.parse(report).iter("testsuite"))
    counts = {name: int(suite.get(name, "-1")) for name in ("errors", "failures", "skipped")}
    assert counts == {"errors": 0, "failures": 0, "skipped": 0}, said
    assert int(suite.get("tests", "0")) >= least


@pytest.mark.slow
@pytest.mark.live
def test_buses_of_a_kernel_with_can(kernel: None, tmp_path: Path) -> None:
    """Frames only, and few of them: the guest's one processor is slow, and slower on a busy host.

    Another test has the rest.
    """
    few = "not burst and not of_two_buses"
    passes_on_a_kernel_with_can(tmp_path, 25, "-k", few, "tests/vcan/test_bus.py")


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.timeout(WHOLE + 2 * PATIENCE)
def test_a_rehearsal_beside_strict_drives_on_a_kernel_with_can(
    kernel: None, tmp_path: Path
) -> None:
    """With ``--hardware``, over vcan, one of each profile."""
    passes_on_a_kernel_with_can(tmp_path, 4, "tests/vcan/test_strict_drives.py")


@pytest.mark.slow
@pytest.mark.timeout(WHOLE + 2 * PATIENCE)
def test_all_of_tests_vcan_passes_on_a_kernel_with_can(kernel: None, tmp_path: Path) -> None:
    passes_on_a_kernel_with_can(tmp_path, 42, "tests/vcan")
