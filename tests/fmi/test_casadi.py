"""An FMU for model exchange that another exporter made: CasADi's DaeBuilder (FMI 3.0).

The only exporter of such FMUs on PyPI, with the extra `oracles`. Its FMUs crash when their variable
`time` is read, which a pattern of recorded signals therefore must not mean.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cosim.cli.commands import app
from cosim.record import Run
from fmus.build.toolchain import compile_shared, shared_suffix
from tests.fmi.runs import Watch, ran
from tests.fmi.watch import HEADERS

pytestmark = pytest.mark.slow


@pytest.fixture
def fmu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Van der Pol's oscillator, x' = v, v' = mu (1 - x^2) v - x + u, from x = 2."""
    casadi = pytest.importorskip("casadi", reason="the extra `oracles` is not installed")
    (folder := tmp_path / "casadi").mkdir()
    monkeypatch.chdir(folder)
    dae = casadi.DaeBuilder("vdp")
    x = dae.add("x", "output", "continuous", {"start": 2.0})
    v = dae.add("v", "local", "continuous", {"start": 0.0})
    u = dae.add("u", "input", "continuous", {"start": 0.0})
    mu = dae.add("mu", "parameter", "tunable", {"start": 1.0})
    dae.eq(dae.der(x), v)
    dae.eq(dae.der(v), mu * (1 - x * x) * v - x + u)
    dae.export_fmu({"no_warning": True, "with_serialization": False})
    binary = folder / f"vdp{shared_suffix()}"
    sources = [folder / "vdp.c", folder / "vdp_wrap.c"]
    flags = ["-std=gnu11", "-fvisibility=default"]
    compile_shared(sources, binary, include=[HEADERS], flags=flags)
    with zipfile.ZipFile(tmp_path / "vdp.fmu", "w") as archive:
        archive.write(folder / "modelDescription.xml", "modelDescription.xml")
        archive.write(binary, f"binaries/x86_64-linux/vdp{shared_suffix()}")
    return tmp_path / "vdp.fmu"


def reference(t: np.ndarray, mu: float) -> np.ndarray:
    from scipy.integrate import solve_ivp

    def rates(_: float, s: np.ndarray) -> list[float]:
        return [s[1], mu * (1.0 - s[0] ** 2) * s[1] - s[0]]

    return solve_ivp(rates, (0.0, t[-1]), [2.0, 0.0], t_eval=t, rtol=1e-12, atol=1e-12).y[0]


@pytest.mark.parametrize(
    ("settings", "within"),
    [(["--set", "run.step=0.01"], 1e-7), (["--set", "components.vdp.solver=cvode"], 1e-6)],
)
def test_it_is_integrated(tmp_path: Path, fmu: Path, settings: list[str], within: float) -> None:
    out = tmp_path / "out"
    given = ["--stop", "5", "--set", "mu=2", "--record", "all", "--out", str(out), *settings]
    if "cvode" in settings[1]:
        given += ["--set", "components.vdp.tolerance=1e-9", "--set", "run.step=0.1"]
    result = CliRunner().invoke(app, ["run", str(fmu), *given, "--no-plot"])
    assert result.exit_code == 0, result.output
    run = Run.open(out)
    assert "vdp.time" not in run.names and "vdp.der(v)" in run.names
    found = run.column("vdp.x")
    t = np.linspace(0.0, 5.0, len(found))
    assert np.abs(found - reference(t, 2.0)).max() < within


@pytest.mark.parametrize("solver", ["rk4", "cvode"])
def test_its_calls_are_in_order(
    tmp_path: Path, fmu: Path, solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Watch(fmu, tmp_path, monkeypatch)
    assert ran(found, 5, 0.1, values={"mu": 2.0}, start={"u": 0.5}, solver=solver) == []
    derivatives = {call.name for call in found.calls()} & {"GetDirectionalDerivative"}
    assert bool(derivatives) == (solver == "cvode")
