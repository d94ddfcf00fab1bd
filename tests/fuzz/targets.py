"""Targets of the fuzzers in this process: readers, and the inputs of which mutants are made.

A reader may refuse its input with a CosimError. Anything else is a finding.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from tests.fuzz import mutate

ROOT = Path(__file__).resolve().parents[2]
CORPUS = Path(__file__).with_name("corpus")
CONFIGS = ROOT / "configs"

Mutator = Callable[[np.random.Generator, bytes, Sequence[bytes]], bytes]


@dataclass(frozen=True)
class Target:
    """A reader under test.

    `read(path)`: reads the file; `suffixes`: of the files in ``corpus/NAME`` and of those in the
    folders `also`; `place(folder)`: context manager giving the folder a mutant is written to.
    """

    name: str
    read: Callable[[Path], None]
    mutate: Mutator
    suffixes: tuple[str, ...]
    also: tuple[Path, ...] = ()
    beside: Path | None = None  # the folder its relative paths count from

    @property
    def fills_cache(self) -> bool:
        """True if every mutant is an archive that is unpacked into the cache."""
        return self.mutate is mutate.of_archive

    def seeds(self) -> list[tuple[str, bytes]]:
        """(suffix, content) of every input that mutants are made of, sorted by path."""
        if self.name == "run":
            return _recorded_run()
        folders = (CORPUS / self.name, *self.also)
        paths = (p for folder in folders for p in sorted(folder.glob("*")))
        found = [(p.suffix, p.read_bytes()) for p in paths if p.suffix in self.suffixes]
        return [(s, few_messages(data) if s == ".dbc" else data) for s, data in found]

    @contextmanager
    def written(self, data: bytes, suffix: str, folder: Path) -> Iterator[Path]:
        """The mutant as a file, for as long as it is read."""
        with tempfile.NamedTemporaryFile(
            dir=self.beside or folder, prefix=".fuzz-", suffix=suffix
        ) as file:
            file.write(data)
            file.flush()
            yield Path(file.name)


#: Messages of a DBC file that mutants are made of: those of a whole link take a tenth of a second.
MESSAGES = 6
_MESSAGE = re.compile(
    rb'^(?:BO_|CM_ (?:BO_|SG_)|BA_ "[^"]*" (?:BO_|SG_)|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|'
    rb"BO_TX_BU_) (\d+)"
)


def few_messages(data: bytes) -> bytes:
    """A DBC file with its first messages only, and what is said of these."""
    kept: list[bytes] = []
    numbers = list[bytes]()
    inside = True
    for line in data.splitlines(keepends=True):
        found = _MESSAGE.match(line)
        if found is not None:
            if line.startswith(b"BO_ ") and len(numbers) < MESSAGES:
                numbers.append(found[1])
            inside = found[1] in numbers
        elif not line.startswith(b" "):
            inside = True
        if inside:
            kept.append(line)
    return b"".join(kept)


# ---- readers --------------------------------------------------------------------------------


def _journal(path: Path) -> None:
    from bridge.native.journal import Journal

    rows = Journal.open(path)
    rows.tobytes()
    len(rows[:1].tolist())


def _buslog(path: Path) -> None:
    from bridge.can.log import read_log

    # python-can looks for readers of plug-ins each time, which takes nine tenths of a mutant's time
    with patch("can.io.player.read_entry_points", return_value=()):
        log = read_log(path)
    for frame in log.frames():
        frame.key()


def _scenario(path: Path) -> None:
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    assemble(load(path))


def _deployment(path: Path) -> None:
    from bridge.deployment.system import load_system
    from bridge.preflight.deployment import check

    check(load_system(CONFIGS / "teleoperation.toml", str(path)))


def _faults(path: Path) -> None:
    from bridge.deployment.carried import Subscription
    from bridge.faults.load import load
    from bridge.native.bus import Accept

    script = load(path)
    known = [
        Subscription("left", "STATE_1", Accept(0x101)),
        Subscription("left", "SYNC", Accept(0x80)),
    ]
    script.frames_for("master", known, {"left": 0})
    script.process_events(["master", "slave"], ["left"])


def _dbc(path: Path) -> None:
    from bridge.can.codec import Codec
    from bridge.can.dbc import load

    for layout in load(path):
        Codec(layout).decode(bytes(layout.length))


def _urdf(path: Path) -> None:
    from fmus.arms import chain
    from fmus.arms.serial import serial
    from fmus.arms.urdf import read
    from fmus.robots import report

    robot = read(path)
    list(report.tree(robot))
    links = list(robot.links)
    chain.check(serial(path, links[0], links[-1]).table, str(path))


def _fmu(path: Path) -> None:
    from cosim.cli.info import _facts, _signals
    from cosim.fmi import FmuComponent

    component = FmuComponent(path)
    _facts(component)
    _signals(component)


def _ssp(path: Path) -> None:
    from cosim.loading.files import load
    from cosim.scenario.assemble import assemble

    assemble(load(path))


def _run(path: Path) -> None:
    """A run folder, packed: read as `cosim show`, `diff` and `replay` read one."""
    from cosim.links.storage import load_table
    from cosim.record import Run

    folder = path.with_suffix("")
    for name, content in mutate.unpacked(path.read_bytes()).items():
        place = (folder / name).resolve()
        if place.is_relative_to(folder.resolve()):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
    run = Run.open(folder)
    assert run.t.shape == (len(run),)
    for name in run.names:
        run.column(name)
    assert isinstance(run.metadata, dict)
    for table in run.link_tables.values():
        load_table(table)


@lru_cache(maxsize=1)
def _recorded_run() -> list[tuple[str, bytes]]:
    """A run of 50 ticks, packed: as today's code writes it."""
    from cosim.engine.simulate import simulate
    from cosim.loading.files import load

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        scenario = load(CONFIGS / "teleoperation.toml", ["run.stop=0.05"])
        simulate(scenario, folder)
        files = [p for p in sorted(folder.rglob("*")) if p.is_file()]
        members = {str(p.relative_to(folder)): p.read_bytes() for p in files}
    return [(".zip", mutate.packed(members))]


TOML = partial(Target, mutate=mutate.of_text, suffixes=(".toml",))
TARGETS = {
    t.name: t
    for t in (
        Target("journal", _journal, mutate.of_bytes, (".journal",)),
        Target("buslog", _buslog, mutate.of_text, (".log", ".asc", ".blf")),
        TOML("scenario", _scenario, also=(CONFIGS,), beside=CONFIGS),
        TOML("deployment", _deployment, also=(CONFIGS / "deploy",), beside=CONFIGS / "deploy"),
        TOML("faults", _faults, also=(CONFIGS / "faults",)),
        Target("dbc", _dbc, mutate.of_text, (".dbc",), (CONFIGS / "can",)),
        Target("urdf", _urdf, mutate.of_text, (".urdf",)),
        Target("fmu", _fmu, mutate.of_archive, (".fmu",)),
        Target("ssp", _ssp, mutate.of_archive, (".ssp",)),
        Target("run", _run, mutate.of_archive, (".zip",)),
    )
}
