"""``cosim monitor`` as users call it: on a folder, and on a rehearsal while it runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from bridge.cli.monitor import monitor
from bridge.deployment.system import load_system
from bridge.rehearsal.supervisor import STARTED
from bridge.replay.replay import load, received_by_life, replay
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import ScenarioError
from cosim.cli.options import flat
from tests.bridge.watching import folder_of

ROOT = Path(__file__).parents[3]
NAMESPACE = (
    "unshare", "--user", "--map-root-user", "--net", "sh", "-c",
    'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"', "sh",
)  # fmt: skip
COSIM = (sys.executable, "-c", "from cosim.cli import main; main()")
SETTINGS = [
    'run.stop="6 s"',
    *[f'deploy.buses.{b}.{k}' for b in ("left", "right")
      for k in ('interface="udp_multicast"', f'channel="{b}"')],
]  # fmt: skip


def call(*arguments: str):
    app = typer.Typer()
    app.command()(flat(monitor))
    return CliRunner().invoke(app, arguments, catch_exceptions=False)


def test_a_run_that_has_ended_is_shown_drawn_and_written(tmp_path):
    folder_of(tmp_path / "run")
    done = call(str(tmp_path / "run"), "--plot", str(tmp_path / "a.png"))
    assert done.exit_code == 0, done.output
    for text in ("t = 2.00 of 2 s; has ended", "master_control", "sync error", "a.png"):
        assert text in done.output
    assert (tmp_path / "a.png").is_file()


def test_the_newest_run_is_taken_or_there_is_none(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match="no run with journals"):
        call()
    folder_of(tmp_path / "runs" / "one")
    assert "t = 2.00" in call("--once").output


@pytest.mark.slow
def test_looking_at_a_rehearsal_that_runs(tmp_path):
    """It ends as if nobody had looked, and the looker notices the end."""
    possible = shutil.which("unshare") and shutil.which("ip")
    if not possible or subprocess.run([*NAMESPACE, "true"], capture_output=True).returncode:
        pytest.skip("no network namespaces here: multicast is not tested outside of one")
    folder = tmp_path / "run"
    rehearse = subprocess.Popen(
        [*NAMESPACE, *COSIM, "rehearse", "configs/teleoperation.toml", "-i", "udp_multicast",
         "--set", SETTINGS[0], "--no-twin", "--no-plot", "--out", str(folder)],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        end = monotonic_ns() + 60 * 10**9
        while not (folder / STARTED).is_file():
            assert rehearse.poll() is None and monotonic_ns() < end
            sleep(0.1)
        sleep(1.5)
        first = look(folder, "--once")
        assert "6 s; runs" in first and "active" in first
        rest = look(folder, "--mcap", str(tmp_path / "live.mcap"))
        assert "t = 6.00 of 6 s; has ended" in rest
        said, _ = rehearse.communicate(timeout=60)
    finally:
        rehearse.kill()
        rehearse.wait()
    assert rehearse.returncode in (0, 3), said  # 3: this machine was too slow to say more
    system = load_system(ROOT / "configs" / "teleoperation.toml", "can", SETTINGS)
    rows = load(folder / "nodes")
    (tmp_path / "again").mkdir()
    assert (
        replay(system, rows, received_by_life(folder / "nodes"), tmp_path / "again").first is None
    )
    slots = sum(len(r) for r in rows.values())
    assert messages(tmp_path / "live.mcap") == 2 * slots


def look(folder: Path, *arguments: str) -> str:
    code = "import typer; from bridge.cli.monitor import monitor; "
    code += "from cosim.cli.options import flat; typer.run(flat(monitor))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder), *arguments],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def messages(path: Path) -> int:
    reader = pytest.importorskip("mcap.reader")
    with path.open("rb") as file:
        return reader.make_reader(file).get_summary().statistics.message_count
