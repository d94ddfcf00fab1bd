"""FMUs on a bus as components of a plan, which step together: the integrated bus simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.bus.candump import candump_lines
from cosim.bus.settings import BusNodeSettings, Disturbance
from cosim.bus.timing import BusTiming
from cosim.fmi.component import FmuComponent
from cosim.fmi.driver import FmuDriver
from cosim.lsbus.logs import operation_lines
from cosim.lsbus.network import CanNetwork
from cosim.lsbus.node import PS, NodeFmu
from cosim.lsbus.operations import LsBusError


@final
class IntegratedBus:
    """A simulated bus inside a plan, and the FMUs on it, which all step in the same ticks.

    The engine sets the inputs of all continuous components before it steps the first of them. So
    the first member that is stepped in a tick steps all of them, with the inputs of that tick; the
    steps of the others return what came out. `settings`: those of nodes that are not the default.
    """

    def __init__(
        self,
        name: str,
        timing: BusTiming,
        members: Sequence[BusMember],
        *,
        disturbances: Sequence[Disturbance] = (),
        seed: int = 0,
        settings: Mapping[str, BusNodeSettings] | None = None,
    ) -> None:
        self.name, self.timing = name, timing
        self.members = tuple(members)
        self._disturbances, self._seed = tuple(disturbances), seed
        self._settings = dict(settings or {})
        self._network: CanNetwork | None = None
        self._now_ps = 0
        for member in members:
            member.bus = self

    @property
    def network(self) -> CanNetwork:
        """The network since the members left Initialization Mode. Raises LsBusError before."""
        if self._network is None:
            raise LsBusError(f"bus {self.name}: found no start, expected one before the first step")
        return self._network

    def reset(self) -> None:
        """Forget the last run: members start anew."""
        self._network = None

    def step(self, t: float, h: float) -> None:
        """Step all members from `t` to `t + h` (s), unless they are there already.

        Raises FmuError and LsBusError for what an FMU must not do, and where one ends the run.
        """
        end = round((t + h) / PS)
        if self._network is None:
            self._begin(h)
        if self._now_ps >= end:
            return
        network = self.network
        network.jump({i for i, m in enumerate(self.members) if m.node.signals.set(m.inputs_now)})
        network.go_on(end)
        if network.ended:
            raise LsBusError(
                f"bus {self.name}: {network.ended} ended the simulation by t = {t + h:.9g} s,"
                " expected FMUs on a bus to go on to the end of the run"
            )
        self._now_ps = end

    def files(self) -> dict[str, str]:
        """The frames as ``candump -l`` writes them, and all operations with their times."""
        if self._network is None:
            return {}
        return {
            f"{self.name}.log": candump_lines(
                ((at, frame) for at, _, frame in self._network.bus.frames), self.name
            ),
            f"{self.name}.operations.tsv": operation_lines(self._network),
        }

    def _begin(self, h: float) -> None:
        """Connect the members, which are at time 0. Raises LsBusError where one is missing."""
        missing = [m.node.name for m in self.members if m.sent is None]
        if missing:
            raise LsBusError(
                f"bus {self.name}: {', '.join(missing)} has not started, expected all nodes of a"
                " bus in one process"
            )
        self._now_ps = 0
        self._network = CanNetwork(
            self.timing,
            [m.node for m in self.members],
            step=h,
            disturbances=self._disturbances,
            seed=self._seed,
            settings=self._settings,
        )
        self._network.start([m.sent or [] for m in self.members])


@final
class BusMember(FmuDriver):
    """An FMU with a CAN terminal as a component; its frames go over the bus it is connected to."""

    def __init__(self, fmu: FmuComponent, terminal: str = "") -> None:
        self.fmu = fmu
        self.node = NodeFmu(fmu, terminal)
        self.kind: Kind = "continuous"
        self.inputs: tuple[Port, ...] = self.node.signals.inputs
        self.outputs: tuple[Port, ...] = self.node.signals.outputs
        self.parameters: tuple[Parameter, ...] = fmu.parameters
        self.bus: IntegratedBus | None = None
        #: What it sent at the start; None before.
        self.sent: list[bytes] | None = None
        #: Its inputs, which the engine keeps up to date.
        self.inputs_now: Values = {}

    @property
    def connected(self) -> str:
        """Its terminal and its bus, in words."""
        bus = self.bus.name if self.bus else "none"
        return f"CAN terminal {self.node.terminal.name} on bus {bus}"

    def initialize(self, values: Values) -> None:
        """Enter Initialization Mode. Raises FmuError, and LsBusError for a start after 0 s."""
        if self.fmu.begin:
            raise LsBusError(
                f"{self.fmu.name}: found a start at {self.fmu.begin:g} s, expected 0 s for an FMU"
                " on a bus"
            )
        self.node.set_values(values)
        self.node.initialize()
        self.sent = None
        if self.bus is not None:
            self.bus.reset()

    def initial(self, u: Values) -> Outputs:
        """Outputs in Initialization Mode for inputs `u`."""
        self.inputs_now = u
        return self.node.signals.initial(u)

    def exit_initialization(self) -> Outputs:
        """Leave Initialization Mode; what it sends then is on the bus from time 0 on."""
        if self.sent is None:
            self.sent = self.node.start()
        return self.node.signals.read()

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Its outputs at `t + h` (s). Raises FmuError and LsBusError of any FMU on the bus."""
        if self.bus is None:
            raise LsBusError(f"{self.fmu.name}: found no bus, expected IntegratedBus to connect it")
        self.inputs_now = u
        self.bus.step(t, h)
        return self.node.signals.read()

    def files(self) -> Mapping[str, str]:
        """The logs of the bus, written with its first member."""
        if self.bus is None or self.bus.members[0] is not self:
            return {}
        return self.bus.files()

    def get_state(self) -> object:
        """Raise LsBusError: the frames on the bus are no state of one FMU."""
        raise LsBusError(f"{self.fmu.name}: is on a bus, whose state cannot be saved")

    def set_state(self, state: object) -> None:
        """Raise LsBusError: see :meth:`get_state`."""
        self.get_state()
