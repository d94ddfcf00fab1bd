"""Results of the commands that need no bus: runs, studies, reproduction, FMUs, texts, refusals."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
import zipfile
from pathlib import Path
from unittest.mock import patch

import numpy as np

from cosim.cli.overview import COMMANDS
from tests.golden.kept import ROOT, Record

CONFIGS = ROOT / "configs"
SCENARIOS = {
    "teleoperation": CONFIGS / "teleoperation.toml",
    "network": CONFIGS / "network.toml",
    "teaching": CONFIGS / "teaching.toml",
    "own controller": ROOT / "examples" / "own_controller" / "scenario.toml",
}
#: Ways to run the first scenario, as settings.
VARIANTS = {
    "jacobi": ['run.algorithm="jacobi"', "run.stop=5"],
    "gauss-seidel": ['run.algorithm="gauss-seidel"', "run.stop=5"],
    "fmi3": [
        "run.stop=5",
        *(f'components.{name}.fmi="3.0"' for name in ("master", "slave", "master_control")),
    ],
    "fifo with losses": [
        "run.stop=20",
        "run.seed=3",
        'links.0.semantics="fifo"',
        'links.1.semantics="last-arrival"',
        'links.1.loss={law="independent", p="20 %"}',
    ],
    "constant": ["run.stop=5", 'links.0.delay={law="constant", delay="80 ms"}'],
}
#: Stands for the first scenario's path in what is refused.
TELEOPERATION = "TELEOPERATION"
STUDY = """
title = "golden"
scenario = "{scenario}"
settings = ["run.stop=3", "run.record.every=5"]
seeds = 2
[vary.lambda_M]
paths = [
    "components.master_control.parameters.lambda_M",
    "components.slave_control.parameters.lambda_M",
]
values = [1, 10]
[stable]
sync_error = 1.0
"""
#: Bad input: what is asked for, by a name.
REFUSED = {
    "no such file": ["run", "nowhere.toml"],
    "unknown key": ["run", TELEOPERATION, "--set", "run.stap=1"],
    "unknown component": ["run", TELEOPERATION, "--set", "components.other.period=1"],
    "a unit that does not fit": ["run", TELEOPERATION, "--set", 'run.step="5 deg"'],
    "a negative stop": ["run", TELEOPERATION, "--set", "run.stop=-1"],
    "not finite": ["run", TELEOPERATION, "--set", "run.stop=inf"],
    "an unknown law": ["run", TELEOPERATION, "--set", 'links.0.delay={law="never"}'],
    "an unknown deployment": ["run", TELEOPERATION, "--deploy", "nowhere"],
    "another clock": ["run", TELEOPERATION, "--deploy", "can", "--clock", "wall"],
    "an unknown node": ["node", TELEOPERATION, "--deploy", "can", "--node", "nobody"],
    "an unknown claim": ["reproduce", "--only", "fig99"],
    "an unknown controller": ["compare", TELEOPERATION, "--controllers", "nobody"],
    "no run": ["replay", "nowhere"],
    "no study": ["sweep", "nowhere.toml"],
    "no FMU": ["info", "nowhere.fmu"],
    "a missing argument": ["run"],
    "an unknown command": ["walk"],
}


def cosim(*arguments: str | Path) -> tuple[int, str, str]:
    """The command in this process: exit code, standard output, standard error."""
    from cosim.cli.commands import command

    out, err = io.StringIO(), io.StringIO()
    plain = {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb", "TERMINAL_WIDTH": "100"}
    with (
        patch.dict(os.environ, plain),
        patch.object(sys, "argv", ["cosim", *map(str, arguments)]),
        patch.object(sys, "path", list(sys.path)),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            command()
            code: object = 0
        except SystemExit as end:
            code = end.code
    return (code if isinstance(code, int) else 0 if code is None else 1), *map(_of, (out, err))


def _of(stream: io.StringIO) -> str:
    return stream.getvalue()


def say(record: Record, name: str, *arguments: str | Path) -> None:
    """Run a command that has to succeed, and keep what it prints."""
    code, out, err = cosim(*arguments)
    if code:
        raise RuntimeError(f"cosim {' '.join(map(str, arguments))}: exit code {code}\n{err}")
    record.measured(name, out)


def scenario(record: Record, name: str) -> None:
    """One of the shipped scenarios: run, shown, checked."""
    path = SCENARIOS[name]
    with contextlib.chdir(path.parent):
        say(record, "run", "run", path, "--no-plot", "--out", record.folder / "run")
        say(record, "show", "show", path)
        say(record, "check", "check", path)
    record.tables(record.folder / "run")


def variant(record: Record, name: str) -> None:
    """The first scenario with other settings."""
    chosen = [x for setting in VARIANTS[name] for x in ("--set", setting)]
    target = record.folder / "run"
    say(record, "run", "run", SCENARIOS["teleoperation"], *chosen, "--no-plot", "--out", target)
    record.tables(target)


def export(record: Record) -> None:
    """A table as CSV, and an SSP of the scenario."""
    path, folder = SCENARIOS["teleoperation"], record.folder
    say(
        record, "run", "run", path, "--set", "run.stop=2", "--csv", "--no-plot",
        "--out", folder / "run",
    )  # fmt: skip
    record.array("csv", np.loadtxt(folder / "run" / "trajectories.csv", delimiter=",", skiprows=1))
    say(record, "export", "export", path, "--ssp", folder / "system.ssp")
    with zipfile.ZipFile(folder / "system.ssp") as archive:
        for name in sorted(archive.namelist()):
            if not name.endswith(".fmu"):
                record.text(f"export {name}", without_build(archive.read(name).decode()))


def study(record: Record) -> None:
    """A small sweep."""
    file = record.folder / "golden.toml"
    file.write_text(STUDY.format(scenario=SCENARIOS["teleoperation"]), encoding="utf-8")
    out = record.folder / "sweep"
    code, _, err = cosim("sweep", file, "--out", out, "--jobs", "1", "--no-plot", "-q")
    if code:
        raise RuntimeError(err)
    record.text("files", "\n".join(sorted(str(p.relative_to(out)) for p in out.rglob("*"))))
    _columns(record, "results", out)


def _columns(record: Record, name: str, folder: Path) -> None:
    """The table of a study with a tolerance: its columns are sums.

    Not what runs took, nor the identity of a run, which depends on where the study is; nor the
    parts, whose order is that of the identities.
    """
    import pyarrow.parquet as pq

    for path in sorted(folder.rglob("table.parquet")):
        read = pq.read_table(path)
        label = f"{name} {path.relative_to(folder)}"
        record.text(f"{label}, columns", "\n".join(sorted(read.column_names)))
        for column in sorted(read.column_names):
            if column == "run" or "wall" in column or "time" in column or "cpu" in column:
                continue
            values = read.column(column).to_pylist()
            if all(isinstance(v, int | float | None) for v in values):
                record.numbers(f"{label}: {column}", values)
            else:
                record.text(f"{label}: {column}", repr(values))


def comparison(record: Record) -> None:
    """Two controllers side by side."""
    out = record.folder / "compare"
    say(
        record, "compare", "compare", SCENARIOS["teleoperation"], "--controllers", "paper,pd",
        "--operators", "free", "--links", "constant", "--set", "run.stop=10", "--jobs", "1",
        "--no-plot", "--out", out,
    )  # fmt: skip
    for path in sorted(out.rglob("*.csv")):
        record.measured(str(path.relative_to(out)), path.read_text(encoding="utf-8"))


def paper(record: Record) -> None:
    """Every claim of the paper, and the numbers of its figures."""
    out = record.folder / "paper"
    cosim("reproduce", "--out", out, "--jobs", "1", "-q")
    claims = json.loads((out / "claims.json").read_text(encoding="utf-8"))["claims"]
    for claim in claims:
        record.numbers(f"claim {claim['name']}", [claim.pop("measured")])
    record.document("claims", claims)
    for path in sorted(out.glob("*.csv")):
        values = np.loadtxt(path, delimiter=",", skiprows=1)
        record.array(path.name, values)
    say(record, "list", "reproduce", "--list")


def without_build(xml: str) -> str:
    """An XML without what depends on when and by which compiler it was built."""
    return re.sub(
        r'(guid|instantiationToken|generationDateAndTime|generationTool|sha256)="[^"]*"',
        r'\1="..."',
        xml,
        flags=re.IGNORECASE,
    )


def fmus(record: Record) -> None:
    """The description of every built FMU, and what else is in it, by name."""
    for path in sorted((ROOT / "fmus" / "_built").glob("*.fmu")):
        with zipfile.ZipFile(path) as archive:
            xml = archive.read("modelDescription.xml").decode()
            record.text(f"{path.name} modelDescription.xml", without_build(xml))
            others = sorted(n for n in archive.namelist() if not n.startswith("binaries/"))
            record.text(f"{path.name} files", "\n".join(others))
    code, out, _ = cosim("info", ROOT / "fmus" / "_built" / "teleoperation.fmi3.fmu")
    steady = re.sub(r"(?m)^(token|sha256)( +).*", r"\1\2...", out)
    record.text("info", f"{code}\n{steady}")


def helps(record: Record) -> None:
    """The help of every command, without the boxes around it."""
    for name in ("", *COMMANDS):
        code, out, _ = cosim(*name.split(), "--help")
        words = " ".join(re.sub(r"[^\x20-\x7e]", " ", out.replace("\n", " ")).split())
        record.text(f"cosim {name}", f"{code} {words}")
    record.text("commands", " ".join(COMMANDS), whole=True)


def refusals(record: Record) -> None:
    """Exit codes and messages of commands that are refused."""
    places = {TELEOPERATION: str(SCENARIOS["teleoperation"])}
    for name, arguments in REFUSED.items():
        with contextlib.chdir(record.folder):
            code, out, err = cosim(*(places.get(a, a) for a in arguments))
        message = " ".join(re.sub(r"[^\x20-\x7e]", " ", (out + err).replace("\n", " ")).split())
        record.text(name, f"{code} {message}", whole=True)


def scaffold(record: Record) -> None:
    """The files that ``cosim new`` writes."""
    with contextlib.chdir(record.folder):
        say(record, "new", "new", "controller", "my_controller")
    for path in sorted(record.folder.rglob("*")):
        if path.is_file():
            name = str(path.relative_to(record.folder))
            record.text(name, path.read_text(encoding="utf-8"))
