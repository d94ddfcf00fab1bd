"""The list of commands and the text of ``cosim --help``; needs no library for commands."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from shutil import get_terminal_size

#: The commands of the first page: the first line of a command's help. Its function has its name and
#: stands in the module of that name in this folder, or it is an entry point (cosim.base.parts).
GROUPS: dict[str, dict[str, str]] = {
    "Simulate": {
        "new": "Write files to start from: for your controller, your arm, or your own node.",
        "run": (
            "Run a scenario; write trajectories, metadata, link tables and a report to a folder."
        ),
        "check": ("Check a scenario: stability of its loop, links, wiring, predictions."),
        "info": (
            "Print the ports and units of an FMU, a model or a scene of MuJoCo; validate an FMU."
        ),
        "report": (
            "Write the report of a run again: a page with diagrams, arms that move, and results."
        ),
    },
    "Judge": {
        "analyze": "Analyze a port: manipulability, felt damping and stiffness, and passivity.",
        "compare": (
            "Compare controllers: run each with every operator and link law, and print one table."
        ),
        "sweep": (
            "Run a parameter study: simulate every point; write a table and a report. Resumable."
        ),
        "falsify": (
            "Search the smallest network that breaks a requirement; exit code 1: found, 0: none "
            "found."
        ),
        "fit": (
            "Fit parameters of a scenario or an FMU to measured data, with confidence intervals."
        ),
        "diff": (
            "Compare two runs signal by signal, largest differences first, and print a verdict."
        ),
    },
    "Rehearse": {
        "doctor": (
            "Check this machine: Python, engine, compiler, networks, CAN, real time; with cures."
        ),
        "rehearse": (
            "Run a scenario in real time, one process per node, on real buses; then check the run."
        ),
        "monitor": "Show the status of a running or finished rehearsal (read-only).",
        "replay": "Recompute a recorded run offline, and compare every signal of every node.",
        "ping": (
            "Measure delays of a network each way and by parts; predict the effect on controllers."
        ),
    },
}
#: The others, which the first page names.
MORE: dict[str, dict[str, str]] = {
    "Scenarios and runs": {
        "show": (
            "Print how a scenario runs: components, rates, order, and what every input samples."
        ),
        "export": "Write a scenario or a run for other tools.",
        "delays": (
            "List delays by name: presets of networks, and frozen traces with their SHA-256 sums."
        ),
    },
    "Models": {
        "identify": "Identify the base parameters of an arm from a recorded run, with intervals.",
        "reproduce": (
            "Reproduce the paper: run Sec. VII and Theorems 1-5, draw figures, check all claims."
        ),
    },
    "Nodes": {
        "node": (
            "Run one node of a deployment: configure it, wait for the start, run until the end."
        ),
        "conform": (
            "Judge one participant, or with --drive a drive, by numbered rules, from outside."
        ),
        "tell": "Send a command or a query to the nodes of a deployment, and print their answers.",
        "keys": (
            "Create a test authority and one certificate per node, for configs/zenoh/secure.json5."
        ),
    },
    "Faults": {
        "campaign": "Run a rehearsal with each fault script of a campaign, and check each run.",
        "soak": "Run a soak test: many rehearsals with random faults, several at once.",
    },
    "Networks": {
        "pong": "Answer the questions of cosim ping, until Ctrl-C.",
        "bus": (
            "Serve a simulated CAN bus to python-can programs, socketcand clients and SocketCAN."
        ),
    },
    "Shell": {
        "completion": 'Print the completion of a shell: eval "$(cosim completion bash)".',
    },
}
#: Both without the groups.
COMMANDS = {
    name: line for group in (*GROUPS.values(), *MORE.values()) for name, line in group.items()
}
#: Earlier names of commands, which this release still takes, and what they are now.
ALIASES = {"recover": ("report", "--recover"), "linearize": ("analyze", "--linear")}
_HEAD = """\
Usage: cosim [OPTIONS] COMMAND [ARGS]...

  Co-simulation of controllers and FMU plants over links with real latency.

Options:
  --version   Print the version and exit.
  -h, --help  Show this message and exit.
"""
_END = """\
Help of a command: cosim COMMAND --help. FMUs of the models: fmus --help.
Begin with: cosim new controller my_law
"""


def overview() -> str:
    """The help of the program, wrapped to the terminal (at most 100 columns)."""
    parts = [_HEAD, *(f"{title}:\n{_rows(group)}\n" for title, group in GROUPS.items())]
    more = {title: ", ".join(group) for title, group in MORE.items()}
    return "\n".join([*parts, f"More commands:\n{_rows(more)}\n", _END])


def _rows(texts: Mapping[str, str]) -> str:
    """Names and texts in two columns."""
    width = min(100, get_terminal_size().columns)
    column = max(len(name) for name in (*COMMANDS, *MORE)) + 4
    return "\n".join(
        textwrap.fill(
            text,
            max(width, column + 20),
            initial_indent=f"  {name}".ljust(column),
            subsequent_indent=" " * column,
            break_on_hyphens=False,
        )
        for name, text in texts.items()
    )
