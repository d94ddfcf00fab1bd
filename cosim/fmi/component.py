"""An ``.fmu`` as a Component: ports, start values, and the interface to the engine."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Kind, Outputs, Values
from cosim.base.errors import FmuError
from cosim.fmi import clocks
from cosim.fmi.file import archive as archives
from cosim.fmi.file import binaries
from cosim.fmi.file.description import read_cached
from cosim.fmi.file.intervals import Intervals
from cosim.fmi.file.ports import together
from cosim.fmi.file.values import (
    NumberedTexts,
    check_range,
    has_text,
    sizes_among,
    start_numbers,
    texts_for,
)
from cosim.fmi.file.variables import TEXTS
from cosim.fmi.instances import instantiate
from cosim.fmi.interface import FmuInterface
from cosim.fmi.library import OK, Instance, Setup
from cosim.fmi.options import FmuOptions
from cosim.fmi.start_calls import StartKind
from cosim.fmi.starting import LoneStart
from cosim.native import fmu_log

if TYPE_CHECKING:
    from cosim.fmi.isolation.remote import RemoteInstance

#: Bytes of log text kept of an FMU whose logging is on.
LOG_ROOM = 1 << 20


class _Move(NamedTuple):
    """A call that sets or gets variables of one type: `size` scalars."""

    type: str
    names: tuple[str, ...]
    references: tuple[int, ...]
    size: int


class FmuComponent(FmuInterface):
    """One instance of an FMU.

    `kind` selects its sampling; FMI has no attribute for it (our FMUs have an annotation), so a
    foreign FMU is continuous unless the scenario specifies otherwise. Numbers and Booleans are
    float64 signals, exact up to 2^53; String and Binary variables are start values and results, and
    signals only where they are connected. Raises FmuError for any error in the file, the
    description or the binary.
    """

    def __init__(
        self,
        path: str | Path,
        name: str = "fmu",
        kind: Kind | None = None,
        options: FmuOptions | None = None,
    ) -> None:
        self.options = options or FmuOptions()
        self.archive = archives.unpack(path)
        path, folder = self.archive.path, self.archive.folder
        interface = self.options.interface
        description = read_cached(folder, path, (), interface)
        given = self.options.given
        sizes = {**sizes_among(description.variables, given), **self.options.sizes}
        if sizes:
            description = read_cached(folder, path, tuple(sizes.items()), interface)
        super().__init__(description)
        self._check_interface(name)
        self.name = name
        usual = "sampled" if self.description.scheduled else "continuous"
        self.kind: Kind = kind or self.description.kind or usual  # type: ignore[assignment]
        texts = {k: v for k, v in given.items() if has_text(self.groups, k)}
        #: Values of String and Binary variables, and sizes of arrays, to start from.
        self.start_texts = texts_for(self.groups, {**texts, **self.options.texts}, name)
        self.sizes: Mapping[str, int] = sizes
        #: Names of `options.given` that are no values of signals or parameters.
        self.taken = frozenset({*sizes, *texts})
        #: Of clocks whose interval was set or asked for, by value reference.
        self.intervals: Intervals = {}
        #: The texts that signals carry, the same for all components of a run.
        self.numbered = NumberedTexts()
        #: Time at which it is initialised, s.
        self.begin = 0.0
        #: Whether the process of an isolated FMU stays for the next instance, until :meth:`end`.
        self.stays = False
        self._instance: Instance | None = None
        self._remote: RemoteInstance | None = None
        self._ticked: dict[str, list[float]] = {}
        self._start: LoneStart | None = None  # in Initialization Mode, started by itself
        self._private: str | None = None
        self._last_text = ""

    def alike(self, name: str) -> FmuComponent:
        """Another component of the FMU, with the same sizes and texts; before the start."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__)
        found.name = name
        return found

    @property
    def special(self) -> frozenset[str]:
        """Names of sizes of arrays, and of String and Binary variables."""
        groups = self.groups.items()
        texts = (name for name, g in groups if g.first.type in TEXTS)
        return frozenset(texts) | {v.name for v in self.description.variables if v.is_size}

    def _check_interface(self, name: str) -> None:
        d, options = self.description, self.options
        if d.states is None and (options.solver or options.max_step is not None):
            raise FmuError(
                f"{name}: found solver or max_step for an FMU with its own solver; expected them "
                "for model exchange only"
            )
        if d.states is not None and any(v.type == "Clock" for v in d.variables):
            raise FmuError(f"{name}: has clocks, which are not supported for model exchange")

    @property
    def instance(self) -> Instance:
        """The active FMI instance. Raises FmuError before :meth:`initialize`."""
        if self._instance is None:
            raise FmuError(f"{self.name}: not initialised")
        return self._instance

    @property
    def remote(self) -> RemoteInstance | None:
        """The active instance if it is in another process, else None."""
        return self._remote if self._instance is not None else None

    @property
    def broken(self) -> int:
        """ERROR or FATAL if an active instance returned it (:mod:`cosim.fmi.library`), else OK."""
        return OK if self._instance is None else self._instance.broken

    @property
    def sandboxed(self) -> bool:
        """True if there is an instance, and it is in WebAssembly: what C calls is Python."""
        return self._instance is not None and self._instance.sandboxed

    @property
    def ours(self) -> bool:
        """True if there is an instance, in this process, of one of our own models without events.

        Its reset and its saved states are exact.
        """
        x = self._instance
        return x is not None and not self.events and bool(x.values_address())

    @property
    def sort(self) -> object:
        """Equal for instances that the engine calls alike: same library, variables and ports."""
        return id(self.description), self._private, self._observed, self._driven, self._wired

    # ---- start -------------------------------------------------------------------------------

    def initialize(self, values: Values) -> None:
        """Instantiate and enter Initialization Mode with `values` set; raises FmuError."""
        self._start = LoneStart(self, values)

    def begin_start(self, logs: Iterator[fmu_log.Log]) -> Setup:
        """Have an instance that has just been made; returns how it is made. Raises FmuError.

        `logs`: where new instances log to.
        """
        self._start, self.intervals = None, {}
        setup = self._setup()
        if not self._reset():
            self.close()
            self._instance = self._instantiate(setup, logs)
        return setup

    def start_kind(self, setup: Setup, names: tuple[str, ...]) -> StartKind:
        """The calls of the start of such FMUs, which are given numbers of these names."""
        names = (*names, *self.sizes)
        if self._private is not None:
            return StartKind(self, setup, names)
        what = f"start {names} {self.start_sort[1:]}"
        return self._derived(what, lambda: StartKind(self, setup, names))

    @property
    def start_sort(self) -> tuple[object, ...]:
        """Equal for FMUs whose start has the same calls if the same values are set."""
        x = self.options
        texts = tuple(group.name for group, _ in self.start_texts)
        limits = x.wasm, x.timeout, x.memory
        return self.sort, x.log, x.isolate, x.build, x.tolerance, limits, texts

    @property
    def observes(self) -> bool:
        """True if variables are outputs that are none in the description."""
        return bool(self._observed)

    def _reset(self) -> bool:
        """Take an instance of one of our own models back to its start, where it is a new one."""
        if not self.ours or self.broken or self.options.log:
            return False
        self.instance.reset()
        return True

    def _setup(self) -> Setup:
        x = self.options
        what = f"setup {x.log} {x.build} {x.tolerance} {x.wasm} {x.timeout} {x.memory}"
        return self._derived(what, self._common_setup)._replace(name=self.name)

    def _common_setup(self) -> Setup:
        d, options = self.description, self.options
        return Setup(
            fmi=d.fmi, name="", token=d.token,
            path=self._binary(),
            resources=self.archive.folder / "resources", logging=options.log,
            event_mode=self.events or d.states is not None, interface=d.interface,
            early_return=self.events or self.returns_early,
            intermediate=self.updated if self.intermediate else None,
            tolerance=d.tolerance if options.tolerance is None else options.tolerance,
            patience=options.timeout, memory=options.memory,
        )  # fmt: skip

    def _binary(self) -> Path:
        """The binary that is run. Raises FmuError, also for what WebAssembly cannot do."""
        d, options = self.description, self.options
        if options.wasm:
            path = binaries.sandboxed(self.archive, d.identifier)
        else:
            path = binaries.binary(self.archive, d.fmi, d.identifier, options.build)
        if binaries.is_sandboxed(path) and d.interface != "CoSimulation":
            raise FmuError(
                f"{self.name}: found {d.interface} in WebAssembly, expected CoSimulation"
            )
        if binaries.is_sandboxed(path) and self.intermediate and self.updated:
            raise FmuError(
                f"{self.name}: found intermediate updates of inputs in WebAssembly; expected "
                'extrapolate = "hold", or an FMU without them'
            )
        return path

    def _instantiate(self, setup: Setup, logs: Iterator[fmu_log.Log]) -> Instance:
        options = self.options
        once = self.description.flags.get("canBeInstantiatedOnlyOncePerProcess")
        if once and not options.isolate and not binaries.is_sandboxed(setup.path):
            self._private = tempfile.mkdtemp(prefix="cosim-")  # a copy is a library of its own
            setup = setup._replace(path=binaries.copied(setup.path, Path(self._private)))
        room = LOG_ROOM if options.log else 0
        if options.isolate and self._wired:
            found = ", ".join(sorted(self._wired))
            raise FmuError(
                f"{self.name}: the texts {found} are connected, which an isolated FMU does not "
                "support; expected isolate = false"
            )
        if options.isolate:
            slopes = self.inputs if self.sloped else ()
            scalars = sum(p.size for p in (*self.inputs, *self.outputs, *slopes))
            from cosim.fmi.isolation.remote import isolated  # few runs need it

            stays = self.stays and not once and not options.memory
            self._remote = isolated(self._remote, setup, options, scalars, room, stays=stays)
            return self._remote
        instance = instantiate(setup, fmu_log.log(room=room) if room else next(logs))
        instance.numbered = self.numbered
        return instance

    def _checked(self, name: str, value: Any) -> list[float]:
        flat: list[float] = np.asarray(value, dtype=np.float64).reshape(-1).tolist()
        check_range(self.groups[name], flat)
        return flat

    def _set(self, name: str, value: Any) -> None:
        group = self.groups[name]
        self.instance.set(group.first.type, group.references, self._checked(name, value))

    def initial(self, u: Values) -> Outputs:
        """Outputs in Initialization Mode for inputs `u`."""
        given = {k: v for k, v in u.items() if self.groups[k].first.type != "Clock"}
        checked = {name: self._checked(name, value) for name, value in given.items()}
        for move in self._moves("set", tuple(checked)):
            values = [v for name in move.names for v in checked[name]]
            if move.type in TEXTS:
                texts = [self.numbered.text(v) for v in values]
                self.instance.set_texts(move.type, move.references, texts)
            else:
                self.instance.set(move.type, move.references, values)
        carried = self.carried("output")
        readable = tuple(g.name for g in carried if g.name not in self._observed)
        return self._outputs(readable) | self._declared()

    def _declared(self) -> dict[str, NDArray[Any]]:
        """Start values of observed variables, which may not be read yet (FMI 2.0.5 §4.2.4)."""
        if not self._observed:
            return {}
        observed = (g for g in self.carried("output") if g.name in self._observed)
        return {g.name: self._shaped(g.name, start_numbers(g)) for g in observed}

    def _outputs(self, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
        found = {n: np.zeros(g.shape) for n in names if (g := self.groups[n]).first.type == "Clock"}
        for move in self._moves("get", tuple(n for n in names if n not in found)):
            values, at = np.array(self._got(move)), 0
            for name in move.names:
                group = self.groups[name]
                found[name] = values[at : at + group.size].reshape(group.shape)
                at += group.size
        return {name: found[name] for name in names}

    def _got(self, move: _Move) -> list[float]:
        if move.type not in TEXTS:
            return self.instance.get(move.type, move.references, move.size)
        texts = self.instance.get_texts(move.type, move.references, move.size)
        return [self.numbered.number(text) for text in texts]

    def _moves(self, verb: str, names: tuple[str, ...]) -> Sequence[_Move]:
        """The calls that set or get these variables: see :func:`together`."""
        return self._derived(f"{verb} {names}", lambda: [
            _Move(kind, tuple(g.name for g in some), tuple(r for g in some for r in g.references),
                  sum(g.size for g in some))
            for kind, some in together(self.groups[name] for name in names)
        ])  # fmt: skip

    def exit_initialization(self) -> dict[str, NDArray[Any]]:
        """Leave Initialization Mode, once; otherwise the first step does it.

        Returns the outputs at that moment, each of its declared shape; of clocked outputs, those
        whose clock ticked. Raises FmuError for parameters and start values that the FMU did not
        take.
        """
        if self._start is None:
            return {}
        start, self._start = self._start, None
        return start.leave()

    def set_intervals(self, values: Values) -> None:
        """Set the intervals of clocks among start values, s. Raises FmuError."""
        self.intervals = clocks.set_intervals(self, values)

    def ask_intervals(self) -> None:
        """Take the intervals of clocks that the FMU defines. Raises FmuError."""
        asked = clocks.intervals_from_fmu(self.description)
        self.intervals = {**self.intervals, **(self.instance.intervals(asked) if asked else {})}

    def leave_initialization(self) -> None:
        """Leave Initialization Mode, with the events at the start. Raises FmuError."""
        self._ticked = self.instance.exit_initialization(clocks.read_clocks(self))

    def first_outputs(self) -> dict[str, NDArray[Any]]:
        """The outputs then, each of its declared shape; of clocked ones, those whose clock ticked.

        Raises FmuError.
        """
        ticked, self._ticked = self._ticked, {}
        free = tuple(
            g.name
            for g in self.carried("output")
            if g.first.type != "Clock" and not (self.clocked and g.first.clocks)
        )
        ticked |= {
            name: [self.numbered.number(t) for t in texts]
            for name, texts in self.instance.clocked_texts().items()
            if name in self._wired
        }
        shaped = {name: self._shaped(name, values) for name, values in ticked.items()}
        return self._outputs(free) | shaped

    def _shaped(self, name: str, values: list[float]) -> NDArray[Any]:
        return np.array(values).reshape(self.groups[name].shape)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Set inputs, ``doStep(t, h)``, get outputs: the slow path, for tests and small programs.

        Raises FmuError if clocks must tick, or the FMU has no solver: only the engine does that.
        """
        if self.description.states is not None:
            raise FmuError(f"{self.name}: is integrated in the engine only (model exchange)")
        if self.clocked and any(v.type == "Clock" for v in self.description.variables):
            raise FmuError(f"{self.name}: has clocks, which tick in the engine only")
        self.exit_initialization()
        for name, value in u.items():
            self._set(name, value)
        self.instance.do_step(t, h)
        return self._outputs(tuple(g.name for g in self.carried("output")))

    def get_state(self) -> object:
        """An FMU state handle of this instance; raises FmuError where the FMU has none."""
        if self.description.states is not None:
            raise FmuError(f"{self.name}: the state of a solver for model exchange is not saved")
        flag = "canGetAndSetFMUstate" if self.description.fmi == "2.0" else "canGetAndSetFMUState"
        if not self.description.flags.get(flag):
            raise FmuError(f"{self.name}: {self.archive.path.name} cannot save its state ({flag})")
        return self.instance.get_state()

    def set_state(self, state: object) -> None:
        """Continue from a state of this instance."""
        assert isinstance(state, int)
        self.instance.set_state(state)

    # ---- what it says, and the end -----------------------------------------------------------

    def results(self) -> dict[str, list[str]]:
        """String and Binary outputs as they stand, Binary as hexadecimal text.

        Those of clocks as they were at the last tick; without one they are left out.
        """
        return self.instance.clocked_texts() | {
            g.name: self.instance.get_texts(g.first.type, g.references, g.size)
            for g in self.groups.values()
            if g.first.causality == "output"
            and g.first.type in TEXTS
            and not (self.clocked and g.first.clocks)
        }

    def log_text(self) -> str:
        """The log of the FMU, if `options.log` is set; also after :meth:`close`."""
        return self._instance.log.text() if self._instance is not None else self._last_text

    def close(self, *, abandon: bool = False) -> None:
        """Free the instance; may be called twice. `abandon`: without any call to the FMU."""
        if self._instance is not None:
            if not abandon:
                self._instance.free()
            self._last_text = self._instance.log.text()
            self._instance = None
        if self._private is not None:
            shutil.rmtree(self._private, ignore_errors=True)
            self._private = None

    def end(self) -> None:
        """End the process that stayed when its instance was freed; may be called twice."""
        if self._instance is None and self._remote is not None:
            self._remote.end()

    def facts(self) -> Mapping[str, str]:
        """Metadata of an FMU for a run."""
        return {
            "file": str(self.archive.path),
            "sha256": self.archive.sha256,
            "fmi": self.description.fmi,
            "tool": self.description.tool,
        }
