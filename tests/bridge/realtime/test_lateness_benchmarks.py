"""The benchmark scripts of the bridge run and report limits. No times are evaluated."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[3] / "benchmarks"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux")


def run(script: str, folder: Path, *options: str) -> tuple[dict[str, Any], str]:
    path = folder / "found.json"
    command = [sys.executable, str(FOLDER / script), "--quick", "--json", str(path), *options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text(encoding="utf-8")), done.stdout


@pytest.mark.slow
def test_lateness(tmp_path: Path) -> None:
    found, said = run("lateness.py", tmp_path, "--figure", str(tmp_path / "late.png"))
    assert len(found["rows"]) == 10
    for row in found["rows"]:
        if "absent" in row:
            assert row["runner"] == "cyclictest"
            assert row["absent"] in said
        else:
            assert row["count"] == round(row["hz"] * 0.05)
    assert found["machine"]["processor"]
    assert (tmp_path / "late.png").read_bytes()[:4] == b"\x89PNG"


def test_roundtrip_through_a_pair_of_sockets(tmp_path: Path) -> None:
    found, said = run("roundtrip.py", tmp_path, "--channel", "pair")
    assert [row["runner"] for row in found["rows"]] == [
        "raw socket in C", "raw in C, stamped, until empty", "our bus, with codec",
    ] * 2  # fmt: skip
    assert all(row["blocks"][0]["count"] == 100 for row in found["rows"])
    assert said.count("\n") == 9


@pytest.mark.slow
@pytest.mark.skipif(Path("/sys/class/net/vcan0").exists(), reason="there is one")
def test_a_launcher_without_an_interface_is_said(tmp_path: Path) -> None:
    command = [sys.executable, str(FOLDER / "roundtrip.py"), "--quick", "--launcher"]
    env = shutil.which("env") or "env"
    done = subprocess.run([*command, env], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "vcan0: found no such interface under the launcher either" in done.stderr


@pytest.mark.slow
def test_zenoh(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    found, said = run("zenoh_latency.py", tmp_path)
    kinds = {row["kind"] for row in found["rows"]}
    assert {"ours", "zenoh, default call-back", "zenoh, direct call-back", "udp"} <= kinds
    assert "zeromq" in kinds or "zeromq: not installed" in said
    assert {row["case"] for row in found["rows"]} == {
        "round trip", "one way, 200 Hz", "one way, 1000 Hz",
    }  # fmt: skip
    assert all(row["us"]["p50"] > 0 for row in found["rows"])
    assert [row["kind"] for row in found["rings"]] == ["ours", "bare zenoh"]
    assert all(0 <= row["unheard"] < 80 for row in found["rings"])
