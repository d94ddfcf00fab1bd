"""States of a drive as it tells them in a frame: the table ``[status]`` of a profile.

The first eight bytes of the frame are one number, little endian. The first state of the table whose
`value` it has under `mask` (or does not have, with `differs`) is the state that the drive tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

from bridge.native.commanded import Told
from bridge.safety.limits import to_si
from cosim.base.errors import ScenarioError

Kind = Literal["other", "disabled", "ramping", "enabled", "fault"]
#: The most states of a profile: steps name them as bits of a number.
STATES = 64
_BITS = 64


@dataclass(frozen=True, slots=True)
class DriveTold:
    """A state that a drive can tell: its name by the vendor, its meaning, and what cures it.

    `kind` "other": frames with the identifier of the status that tell no state.
    """

    name: str
    kind: Kind
    mask: int
    value: int = 0
    differs: bool = False
    cure: str = ""

    @property
    def meaning(self) -> Told:
        """The meaning as C has it."""
        return Told[self.kind.upper()]

    def fits(self, word: int) -> bool:
        """True if a drive that tells `word` is in this state."""
        return ((word & self.mask) != self.value) == self.differs


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """The frame in which a drive tells its state; no `message`: it tells none.

    `message`, `step`: as in a feedback message of the profile; `within`: the time after which a
    state is too old, s; `number`: bits of the word that carry the number of the drive; `every`: the
    time between two of a drive that tells its state by itself, s, as its `register` is to be set;
    0: it answers commands.
    """

    message: str = ""
    step: int = 0
    within: float = 0.0
    number: int = 0
    states: tuple[DriveTold, ...] = ()
    every: float = 0.0
    register: str = ""

    def at(self, word: int) -> DriveTold | None:
        """The state in the first eight bytes of a frame; None: the table has none for it."""
        return next((state for state in self.states if state.fits(word)), None)

    def bits(self, names: tuple[str, ...]) -> int:
        """Bits of the states with these names, or of these kinds."""
        found = (
            1 << i
            for i, state in enumerate(self.states)
            if state.name in names or state.kind in names
        )
        return sum(found)

    def describe(self, word: int) -> str:
        """The state in a word for people: ``LOST_COMMUNICATION (clear it)``."""
        state = self.at(word)
        if state is None:
            return f"an unknown state ({word:#x})"
        return f"{state.name} ({state.cure})" if state.cure else state.name

    def own(self, node: int) -> int:
        """The value of the bits `number` for a drive with this number."""
        lowest = self.number & -self.number
        return (node * lowest) & self.number


#: A drive that tells no state.
NO_STATUS = DriveStatus()


def read_status(table: dict[str, Any], place: str) -> DriveStatus:
    """The table ``[status]`` of a profile. Raises ScenarioError."""
    if not table:
        return NO_STATUS
    known = {"message", "step", "within", "number", "states", "every", "register"}
    if odd := sorted(set(table) - known):
        text = f"has no {odd[0]!r}, expected some of {', '.join(sorted(known))}"
        raise ScenarioError(text, place)
    states = table.get("states", ())
    if not isinstance(table.get("message"), str) or not isinstance(states, list) or not states:
        raise ScenarioError("expected message = NAME and states = [...]", place)
    if len(states) > STATES:
        raise ScenarioError(f"has {len(states)} states, expected at most {STATES}", place)
    found = tuple(_state(s, f"{place}.states[{i}]") for i, s in enumerate(states))
    if not any(state.kind == "enabled" for state in found):
        raise ScenarioError('has no state with kind = "enabled", expected one', place)
    within = to_si(table.get("within", 0.0), "s", f"{place}.within")
    if not within > 0:
        raise ScenarioError("within is missing, expected a time above 0", place)
    every = to_si(table.get("every", 0.0), "s", f"{place}.every")
    if not 0 <= every <= within / 2:
        text = f"is {every:g} s, expected a time of at most half of within, {within:g} s"
        raise ScenarioError(text, f"{place}.every")
    return DriveStatus(
        table["message"], int(table.get("step", 0)), within, int(table.get("number", 0)), found,
        every, str(table.get("register", "")),
    )  # fmt: skip


def _state(table: Any, place: str) -> DriveTold:
    try:
        state = DriveTold(**table)
    except TypeError as error:
        raise ScenarioError(f"{error}", place) from None
    if state.kind not in get_args(Kind):
        text = f"kind is {state.kind!r}, expected one of {', '.join(get_args(Kind))}"
        raise ScenarioError(text, place)
    if not 0 <= state.value <= state.mask < 1 << _BITS or state.value & ~state.mask:
        text = f"value {state.value:#x} has bits outside of mask {state.mask:#x}"
        raise ScenarioError(text, place)
    return state
