"""An FMU that ends the simulation in a node: the run ends for all, as a finished one."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.cli.commands import app
from cosim.record import Run
from tests.cosim.fmi.exporter import export, strict2, strict3

SCENARIO = Path("configs/teleoperation.toml").resolve()
ENDS = 6


def beside_the_slave(folder: Path, fmi: str) -> list[str]:
    """Options: an FMU in the slave's node that ends the simulation at t = 0.1 s."""
    path = export(strict2() if fmi == "2.0" else strict3(), folder / "strict.fmu")
    extra = f'{{model="{path}", parameters={{how={ENDS}, when=0.1}}, start={{u=1}}}}'
    return [
        *("--set", "run.stop=0.5", "--set", f"components.extra={extra}"),
        *("--set", 'deploy.nodes.slave.components=["slave", "extra"]'),
        *("--no-plot", "--out", str(folder / "run")),
    ]


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_twin_ends_with_it(tmp_path: Path, fmi: str) -> None:
    arguments = ["run", str(SCENARIO), "--deploy", "can", *beside_the_slave(tmp_path, fmi)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert Run.open(tmp_path / "run").t[-1] == pytest.approx(0.1, abs=0.005)


@pytest.mark.slow
def test_a_rehearsal_ends_with_it(tmp_path: Path) -> None:
    options = beside_the_slave(tmp_path, "3.0")
    arguments = ["rehearse", str(SCENARIO), "-i", "udp_multicast", "--no-twin", *options]
    result = CliRunner().invoke(app, arguments)
    assert "ended by extra at t = 0.1005 s" in result.output
    assert "difference exactly 0" in result.output
    assert result.exit_code == 0, result.output
