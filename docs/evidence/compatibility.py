"""Write the tables of ``compatibility.md``: ``python docs/evidence/compatibility.py``.

Rows are tests of this project with the FMUs and systems of another tool; versions are those that
are installed here (extras `test` and `oracles`).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("compatibility.md")

BEGIN, END = "<!-- written by docs/evidence/compatibility.py -->\n", "<!-- end -->\n"
#: Kinds of rows, and the heading of each table.
KINDS = {
    "import": "Files of other tools, run here",
    "export": "Files of this project, run by other tools",
    "check": "Files of this project, checked by other tools",
}


#: The package of each tool.
PACKAGES = {
    "PythonFMU": "pythonfmu",
    "PythonFMU3": "pythonfmu3",
    "CasADi": "casadi",
    "FMU Manipulation Toolbox": "fmu-manipulation-toolbox",
    "pyssp-standard": "pyssp-standard",
    "FMPy": "fmpy",
    "libcosim": "libcosimpy",
    "Ecos": "ecospy",
}


@dataclass(frozen=True, slots=True)
class Tested:
    """A tool, the files of a test, and the test as ``file::function``."""

    kind: str
    tool: str
    what: str
    test: str

    @property
    def package(self) -> str:
        """The package of the tool."""
        return PACKAGES[self.tool]


TESTED = (
    Tested("import", "PythonFMU", "FMU 2.0, co-simulation",
           "tests/cosim/fmi/test_other_exporters.py::test_it_runs_to_the_last_bit"),
    Tested("import", "PythonFMU3", "FMU 3.0, co-simulation",
           "tests/cosim/fmi/test_other_exporters.py::test_it_runs_to_the_last_bit"),
    Tested("import", "CasADi", "FMU 3.0, model exchange",
           "tests/fmi/test_casadi.py::test_it_is_integrated"),
    Tested("import", "FMU Manipulation Toolbox",
           "FMU 2.0, a container of FMUs and links",
           "tests/ssp/test_export.py::test_a_closed_loop_with_its_latency_is_one_fmu"),
    Tested("import", "pyssp-standard", "SSP 1.0 and 2.0",
           "tests/ssp/test_written_elsewhere.py::test_it_runs_as_the_scenario_by_hand"),
    Tested("export", "FMPy", "FMU 2.0 and 3.0, co-simulation: every model",
           "tests/fmi/test_masters.py::test_a_model_gives_the_same_numbers"),
    Tested("export", "FMPy", "FMU 2.0 and 3.0, model exchange: plants",
           "tests/fmus/test_exchange.py::test_fmpy_finds_no_problem_and_simulates_it"),
    Tested("export", "FMPy", "SSP 1.0",
           "tests/ssp/test_export.py::test_fmpy_runs_it_to_the_same_trajectory"),
    Tested("export", "FMPy", "FMU 3.0 with FMI-LS-BUS 1.0: nodes and CAN bus",
           "tests/bridge/export/test_node_fmu.py"
           "::test_frames_are_the_same_with_fmpy_and_the_bus_fmu"),
    Tested("export", "libcosim", "FMU 2.0, co-simulation: every model",
           "tests/fmi/test_masters.py::test_a_model_gives_the_same_numbers"),
    Tested("export", "Ecos", "FMU 2.0, co-simulation: every model",
           "tests/fmi/test_masters.py::test_a_model_gives_the_same_numbers"),
    Tested("export", "Ecos", "SSP 1.0, links as FMUs",
           "tests/ssp/test_export.py::test_ecos_sees_the_same_latency_to_the_last_bit"),
    Tested("export", "FMU Manipulation Toolbox",
           "a container with FMI-LS-BUS 1.0: nodes and CAN bus",
           "tests/fmus/test_bus_container.py"
           "::test_the_first_node_of_a_container_hears_the_other_one"),
    Tested("export", "pyssp-standard", "SSP 1.0, read",
           "tests/ssp/test_written_elsewhere.py::test_what_we_write_it_reads"),
    Tested("check", "FMPy", "FMU 2.0 and 3.0: schemas and rules",
           "tests/fmus/test_conformance.py::test_fmpy_finds_no_problem"),
    Tested("check", "FMU Manipulation Toolbox",
           "FMU 2.0 and 3.0: its checks",
           "tests/fmus/test_second_checker.py::test_a_second_checker_finds_nothing"),
)  # fmt: skip


def installed() -> dict[str, str]:
    """The versions of the packages of all rows. Raises SystemExit where one is missing."""
    try:
        return {name: version(name) for name in sorted(PACKAGES.values())}
    except PackageNotFoundError as error:
        sys.exit(f"{error}; expected: pip install -e '.[test,oracles]'")


def tables(versions: Mapping[str, str]) -> str:
    """Everything that is written, with the `versions` of packages."""
    return "\n".join(_lines(versions)) + "\n"


def _lines(versions: Mapping[str, str]) -> Iterator[str]:
    for kind, heading in KINDS.items():
        yield from (
            "",
            f"## {heading}",
            "",
            "| tool | version | files | test |",
            "|---|---|---|---|",
        )
        for one in (t for t in TESTED if t.kind == kind):
            package = f"{one.package} {versions[one.package]}"
            yield f"| {one.tool} | {package} | {one.what} | {_link(one.test)} |"


def _link(test: str) -> str:
    path = test.partition("::")[0]
    return f"[{path.rpartition('/')[2]}](../../{path})"


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    made = before + BEGIN + tables(installed()) + END + rest.split(END)[1]
    PAGE.write_text(made, encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
