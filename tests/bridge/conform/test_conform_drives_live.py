"""The kit of drives on a bus in real time, beside strict drives in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.strict_drives.cases import COSIM, NAMESPACE, ROOT

CHANNEL, AGAIN = "239.74.163.9", 3
OUTSIDE = ROOT / "tests" / "strict_drives" / "outside"
#: A process that says "ready" when its drive is on the bus, and lives until its input ends.
STRICT = "from tests.strict_drives.__main__ import main; import sys; sys.exit(main(sys.argv[1:]))"
OF_OTHERS = f"""
import sys
source = open(sys.argv[1], encoding="utf-8").read().split("L, R = A(")[0]
sys.path.insert(0, {str(OUTSIDE)!r})
exec(source)
arm = A({CHANNEL!r}) if "class A:" in source else Arm({CHANNEL!r}, [3], [0.3])
print("ready", flush=True)
sys.stdin.read()
"""
JUDGE = """
import json, subprocess, sys
drive, words = json.loads(sys.argv[1])
beside = subprocess.Popen(drive, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
assert beside.stdout.readline() == "ready\\n"
done = subprocess.run(words)
beside.stdin.close()
beside.wait(20)
sys.exit(done.returncode)
"""
pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


def judged(drive: list[str], folder: Path, *words: str) -> dict[str, str]:
    """The rules that were not passed, and their verdicts."""
    file = folder / "verdicts.json"
    command = [*COSIM, "conform", "-i", "udp_multicast", "-c", CHANNEL, "--may-move"]
    command += ["--json", str(file), "--quiet", *words]
    spec = json.dumps([[sys.executable, "-c", *drive], command])
    done = subprocess.run(
        [*NAMESPACE, sys.executable, "-c", JUDGE, spec],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert file.is_file(), done.stdout + done.stderr
    rules = json.loads(file.read_text("utf-8"))["rules"]
    return {r["rule"]: f"{r['verdict']}: {r['came']}" for r in rules if r["verdict"] != "passed"}


@pytest.mark.parametrize("kind", ["damiao", "odrive", "cia402"])
def test_a_strict_drive_keeps_the_rules(kind: str, tmp_path: Path) -> None:
    """A machine that is busy lets the drive's process answer late: then once more."""
    words = [kind, "--interface", "udp_multicast", "--channel", CHANNEL, "--drives", "3"]
    words += ["--log", str(tmp_path / "log.jsonl"), "--timeout", "100", "--host", "1"]
    for _ in range(AGAIN):
        options = ("--drive", kind, "--node", "3", "--watchdog", "100 ms")
        found = judged([STRICT, *words], tmp_path, *options)
        if not found:
            return
    raise AssertionError(found)


@pytest.mark.parametrize(
    ("file", "words", "broken"),
    [
        ("dm.py", ("damiao", "3", "0 s"), {"D-04", "D-08"}),  # not applicable
        ("od_run.py", ("odrive", "1", "20 ms"),
         {"O-05", "O-06", "O-09", "O-12", "O-14", "O-18", "O-19", "O-21"}),
    ],
)  # fmt: skip
def test_simple_drives_of_others(
    file: str, words: tuple[str, str, str], broken: set[str], tmp_path: Path
) -> None:
    """They keep the rules, but for those whose part of the protocol they do not have."""
    kind, node, watchdog = words
    options = ("--drive", kind, "--node", node, "--watchdog", watchdog)
    for _ in range(AGAIN):
        found = judged([OF_OTHERS, str(OUTSIDE / file)], tmp_path, *options)
        if set(found) <= broken:
            break
    assert set(found) <= broken, found
    if kind == "damiao":
        assert all(text.startswith("not applicable") for text in found.values())
