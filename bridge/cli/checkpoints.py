"""The options ``--checkpoint`` and ``--resume`` of ``cosim rehearse``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.base.copies import field_names, replace
from cosim.base.errors import ScenarioError
from cosim.cli.options import OutputOptions, wall_seconds

if TYPE_CHECKING:
    from bridge.cli.options import DeployOptions, HardwareOptions
    from bridge.cli.rehearsal_options import RehearsalOptions
    from bridge.rehearsal.kept_run import KeptRun

#: Options that a command with --resume may have beside those of the output.
_BESIDE = ("resume", "checkpoint", "hosts", "twin", "log", "realtime")


def begun(
    scenario: Path, deployment: Path, settings: Sequence[str], options: RehearsalOptions
) -> KeptRun:
    """The run of a command with --checkpoint. Raises ScenarioError."""
    from bridge.rehearsal.kept_run import KeptRun
    from cosim.cli.summary import this_command

    refused = {
        "--nodes": options.nodes, "--outside": options.outside, "--faults": options.faults,
        "--firmware": options.firmware,
    }  # fmt: skip
    for option, said in refused.items():
        if said:
            raise ScenarioError(
                f"found {option} with --checkpoint, expected it without: only the states of this "
                "project's nodes are saved"
            )
    given = {
        "command": this_command(), "place": os.getcwd(), "scenario": str(scenario),
        "deployment": str(deployment), "settings": list(settings),
        "hosts": None if options.hosts is None else str(options.hosts),
    }  # fmt: skip
    return KeptRun(wall_seconds(options.checkpoint or "", "--checkpoint"), given)


def resumed(
    scenario: Path | None,
    deploy: DeployOptions,
    hardware: HardwareOptions,
    options: RehearsalOptions,
) -> tuple[KeptRun, RehearsalOptions]:
    """The run that is resumed, and the options of its command. Raises ScenarioError."""
    from bridge.rehearsal.kept_run import KeptRun

    assert options.resume is not None
    output = {*field_names(OutputOptions)} - {"out", "force"}
    words = ["a scenario"] * (scenario is not None)
    for part in (deploy, hardware, options):
        usual = type(part)()
        words += [
            f"--{name.strip('_').replace('_', '-')}"
            for name in field_names(part)
            if name not in {*output, *_BESIDE} and getattr(part, name) != getattr(usual, name)
        ]
    if words:
        raise ScenarioError(
            f"found {', '.join(words)} with --resume; expected it alone, or with --checkpoint, "
            "--hosts and options of the output, since the run continues as it began"
        )
    interval = options.checkpoint
    kept = KeptRun.open(
        options.resume, None if interval is None else wall_seconds(interval, "--checkpoint")
    )
    options.say(f"resumed: {kept.given['command']}")
    hosts = options.hosts or (kept.given["hosts"] and Path(kept.given["hosts"]))
    return kept, replace(options, out=options.resume, hosts=hosts)
