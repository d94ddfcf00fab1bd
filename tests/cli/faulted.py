"""Commands in which the n-th call of the system fails, for many n: see ``failing.py``."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from shutil import copytree, rmtree
from typing import Any

from cosim.base.copies import replace
from tests.bridge.zenoh.rehearsed import sockets
from tests.cli.command import CONFIG, ROOT

TWIN = ("--deploy", "can", "--set", "run.stop=1")
#: {here}: what is written; {study}: of a sweep.
COMMANDS: dict[str, Sequence[str]] = {
    "run": ("run", str(CONFIG), "--quiet", "--no-plot", "--set", "run.stop=40", "--out", "{here}"),
    "twin": ("run", str(CONFIG), *TWIN, "--quiet", "--no-plot", "--out", "{here}"),
    "sweep": (
        "sweep", "{study}", "--quiet", "--no-plot", "--workers", "threads", "--jobs", "1",
        "--out", "{here}",
    ),
    "replay": ("replay", "{here}"),
    "offline": ("replay", "{here}", "--offline"),
    "lockstep": (
        "rehearse", str(CONFIG), "--deploy", "zenoh", "--clock", "lockstep", "--no-plot", "--quiet",
        "--no-twin", "--set", "run.stop=0.5", "--set", "deploy.patience=20 s",
        "--set", "deploy.buses.net.options.wait=\"3 s\"", "--out", "{here}",
    ),
}  # fmt: skip
REPLAYS = ("replay", "offline")  # of a run that is given
NODES = {"lockstep": ("master", "slave")}  # processes of their own, each with calls of its own
STUDY = """
scenario = "{}"
keep = "trajectories"
[vary.stop]
paths = ["run.stop"]
values = [0.5, 1.0]
"""
#: Every n up to this, and so many beyond.
ALL, BEYOND = 200, 20


@dataclass(frozen=True, slots=True)
class Case:
    """Call `at` of process `who` ("": the command's; or a node's) fails with `errno`.

    `keep`: all later ones as well. `root`: the folder whose calls are counted; `arguments`: of
    ``cosim``, which writes to `root`/here. `whole`: the folder of the first case, "": this is it.
    """

    at: int
    who: str
    errno: int
    keep: bool
    root: str
    arguments: tuple[str, ...]
    whole: str = ""

    @property
    def here(self) -> Path:
        """The folder that the command writes to."""
        return Path(self.root, "here")


@dataclass(frozen=True, slots=True)
class Faulted:
    """Makes and runs cases of one command.

    `shim`: ``faulty.c``, compiled; `folder`: for everything; `given`: a recorded run; `programs`:
    that work at once.
    """

    shim: Path
    folder: Path
    given: Path
    command: str
    programs: int = 1

    def case(self, number: int, case: Case) -> Case:
        """`case` in folder `number`, with all its arguments, and what the command reads."""
        root = self.folder / f"{number}"
        root.mkdir(parents=True)
        study = self.folder / "study.toml"
        if not study.exists():
            study.write_text(STUDY.format(CONFIG))
        if self.command in REPLAYS:
            copytree(self.given, root / "here")
        names = {"here": root / "here", "study": study}
        words = [a.format(**names) for a in COMMANDS[self.command]]
        for setting in sockets(NODES.get(self.command, ()), root):
            words += ["--set", setting]
        return replace(case, root=str(root), arguments=tuple(words))

    @contextmanager
    def program(self) -> Iterator[Callable[[Case], dict[str, Any]]]:
        """A program that runs cases: a function that gives what came of one."""
        with subprocess.Popen(
            [sys.executable, "-m", "tests.cli.failing"],
            cwd=ROOT, env=os.environ | {"LD_PRELOAD": str(self.shim), "PYTHONPATH": str(ROOT)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        ) as program:  # fmt: skip

            def ask(case: Case) -> dict[str, Any]:
                assert program.stdin is not None and program.stdout is not None
                program.stdin.write(json.dumps(asdict(case)) + "\n")
                program.stdin.flush()
                return json.loads(program.stdout.readline())

            yield ask

    def check(self, draw: Callable[[Mapping[str, int]], Sequence[Case]]) -> None:
        """Run the cases that `draw` makes of the numbers of calls of each process.

        Raises AssertionError that names every case that does not end as it has to.
        """
        wrong: list[str] = []
        with ExitStack() as stack:
            ask = [stack.enter_context(self.program()) for _ in range(self.programs)]
            calm = [self.case(i, Case(0, "", 0, False, "", ())) for i in range(self.programs)]
            found, *_ = [asked(case) for asked, case in zip(ask, calm, strict=True)]
            wrong += [f"undisturbed: {found['wrong']}"] if found["wrong"] else []
            cases = list(enumerate(draw(found["calls"]), start=self.programs))
            failed = [0]

            def run(ask: Callable[[Case], dict[str, Any]]) -> None:
                while cases:
                    number, case = cases.pop()
                    made = self.case(number, replace(case, whole=f"{calm[0].here}"))
                    said = ask(made)
                    failed[0] += said["code"] != 0
                    if said["wrong"]:
                        which = f"call {case.at} of {case.who or 'the command'}"
                        how = f"{os.strerror(case.errno)}{', and all later ones' * case.keep}"
                        wrong.append(f"{which} ({how}): {said['wrong']}")
                    rmtree(made.root)

            with ThreadPoolExecutor(self.programs) as pool:
                list(pool.map(run, ask))
        assert not wrong, "\n".join(wrong)
        assert failed[0], "no call failed: the shim does nothing"


def every(seed: str, calls: Mapping[str, int]) -> list[Case]:
    """A case for each call up to ALL of each process, and BEYOND of those after it."""
    draw = Random(seed)
    found = []
    for who, last in sorted(calls.items()):
        beyond = range(ALL + 1, last + 1)
        numbers = [*range(1, min(last, ALL) + 1), *draw.sample(beyond, min(BEYOND, len(beyond)))]
        for n in numbers:
            error, keep = draw.choice((errno.ENOSPC, errno.EIO)), draw.random() < 0.5
            found.append(Case(n, who, error, keep, "", ()))
    return found
