"""Results as Markdown tables, and what machine they are from."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.cases import CHOICES
from cosim import __version__
from fmus.build.toolchain import compiler

Facts = Mapping[str, Any]

PACKAGES = (
    "numpy", "pyarrow", "matplotlib", "msgspec", "typer", "rich", "fmpy", "libcosimpy", "ecospy",
    "fmu-manipulation-toolbox", "mosaik", "helics", "cma",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """Processor, system, compiler, versions, and how busy it is."""
    packages: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = None
    command = [*compiler(), "--version"]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "compiler": said.splitlines()[0] if said else command[0],
        "cosim": __version__,
        "packages": packages,
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def grid(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table, padded so that it reads as text."""
    table = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    lines = ["| " + " | ".join(t.ljust(w) for t, w in zip(row, widths, strict=True)) + " |"
             for row in table]  # fmt: skip
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(lines)


def main_table(results: Sequence[Facts], fmi: str) -> str:
    """Runners down, cases across: best µs, median µs, ratio of the best, and what is off."""
    cases = [r for r in results if r["fmi"] == fmi]
    runners = list(dict.fromkeys(row["runner"] for r in cases for row in r["rows"]))
    rows = []
    for runner in runners:
        found = [next((x for x in r["rows"] if x["runner"] == runner), None) for r in cases]
        rows.append([runner, *(_cell(x) for x in found)])
    return grid(["µs per FMU step", *(r["title"] for r in cases)], rows)


def _cell(row: Facts | None) -> str:
    if row is None:
        return ""
    if "min_us" not in row:
        return str(row["absent"])
    mark = " ≠" if row["same"] is False else ""
    return f"{row['min_us']:.3g} ({row['median_us']:.3g}) {row['ratio_min']:.3g}×{mark}"


def choice_table(results: Sequence[Facts]) -> str:
    """Choices down, cases across; `=`: the bytes of FMI 2.0."""
    rows = []
    for choice, title in CHOICES.items():
        cells = []
        for r in results:
            row = r["choices"][choice]
            same = {True: " =", False: f" ({row['difference']:.1g})", None: ""}[row["same"]]
            cells.append(f"{row['min_us']:.3g} ({row['median_us']:.3g}){same}")
        rows.append([title, *cells])
    return grid(["µs per step", *(r["title"] for r in results)], rows)


def delay_table(results: Sequence[Facts]) -> str:
    """What links add, ns a scalar and tick."""
    rows = []
    for r in results:
        us = {label: f"{row['min_us']:.3g} ({row['median_us']:.3g})"
              for label, row in r["rows"].items()}  # fmt: skip
        rows.append([
            f"{r['case']}, {r['scalars']} scalars, {r['links']}",
            us["wires"],
            *(f"{us[k]}: +{ns:.3g} ns" for k, ns in r["added_ns"].items()),
        ])  # fmt: skip
    header = ["µs per FMU step", "wires"]
    header += [f"{k}: ns a scalar" for k in results[0]["added_ns"]] if results else []
    return grid(header, rows)
