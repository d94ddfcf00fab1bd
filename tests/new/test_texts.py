"""Text parameters of an FMU from elsewhere (PythonFMU) keep their values in an SSP."""

from __future__ import annotations

from pathlib import Path

from pythonfmu.builder import FmuBuilder

from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.ssp import load
from cosim.ssp.export import write
from tests.ssp.parts import recorded

SLAVE = """\
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real, String


class Named(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.called, self.length = "nobody", 0.0
        fixed = Fmi2Variability.fixed
        self.register_variable(
            String("called", causality=Fmi2Causality.parameter, variability=fixed)
        )
        self.register_variable(Real("length", causality=Fmi2Causality.output))

    def do_step(self, t, h):
        self.length = float(len(self.called))
        return True
"""


def test_a_text_goes_into_the_file_and_comes_back(tmp_path: Path) -> None:
    (tmp_path / "named_slave.py").write_text(SLAVE)
    fmu = Path(FmuBuilder.build_FMU(tmp_path / "named_slave.py", dest=tmp_path))
    table = {"model": str(fmu), "parameters": {"called": "operator"}}
    run = {"step": 0.1, "stop": 0.3}
    read = build({"run": run, "components": {"named": table}}, tmp_path / "x.toml")
    write(read, assemble(read), tmp_path / "x.ssp")
    again = load(tmp_path / "x.ssp")
    assert again.components["named"].parameters == {"called": "operator"}
    assert recorded(again)["named.length"][-1] == len("operator")
