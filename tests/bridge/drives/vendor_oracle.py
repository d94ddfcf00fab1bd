"""States of drives in their vendors' documents, as plain tables; a tick is half a millisecond.

Written apart from ``bridge/c/vendor_*.c``: names of states, not codes; ticks, not events.
"""

from __future__ import annotations

from dataclasses import dataclass, field

#: Ticks: a drive cycle, the watchdog, a quick stop, a fault reaction, a boot.
CYCLE, WATCHDOG, QUICK, REACTION, BOOT = 2, 40, 40, 10, 100


@dataclass
class Oracle:
    """States, and when the next change comes; `fed`: tick of what its watchdog waits for."""

    state: str = "off"
    then: str = ""
    due: int = -1
    fed: int = 0
    now: int = 0
    errors: list[str] = field(default_factory=list)
    answers: int = 0
    boots: int = -1

    def tick(self) -> None:
        """Half a millisecond later."""
        self.now += 1
        if self.boots >= 0:
            self.boots -= 1
            if self.boots == 0:
                self.begin()
                self.boots = -1
            return
        self.pass_time()

    def begin(self) -> None:
        """Power-up is over."""
        self.state, self.then, self.due, self.errors = "off", "", -1, []

    def reboot(self) -> None:
        """The power goes and comes."""
        self.begin()
        self.boots, self.answers = BOOT, 0

    @property
    def booting(self) -> bool:
        """It hears and says nothing."""
        return self.boots >= 0

    def later(self, state: str) -> None:
        """In this state at the next cycle."""
        self.then, self.due = state, self.now + CYCLE

    def pass_time(self) -> None:
        """A drive that is on and not fed goes off with an error; then what was asked happens."""
        if self.state == "on" and self.now - self.fed > WATCHDOG:
            self.fail("watchdog")
        elif self.due == self.now:
            self.state, self.then, self.due = self.then, "", -1

    def fail(self, error: str) -> None:
        """An error, which switches it off."""
        self.state, self.then, self.due, self.errors = "off", "", -1, [error]


class Damiao(Oracle):
    """Answers each command; an error has to be cleared before it can be enabled."""

    def enable(self) -> None:
        self.fed, self.answers = self.now, self.answers + 1
        if self.state == "off" and not self.errors:
            self.later("on")

    def disable(self) -> None:
        self.fed, self.answers = self.now, self.answers + 1
        self.state, self.due = "off", -1

    def clear(self) -> None:
        self.fed, self.answers = self.now, self.answers + 1
        self.errors = []

    def torque(self) -> None:
        self.fed, self.answers = self.now, self.answers + 1

    def nibble(self) -> int:
        """State in its feedback."""
        codes = {"watchdog": 0xD, "current": 0xA}
        return codes[self.errors[0]] if self.errors else int(self.state == "on")


class ODrive(Oracle):
    """Refuses closed loop with errors; set-points feed it."""

    result = "success"

    def begin(self) -> None:
        super().begin()
        self.result = "success"

    def enable(self) -> None:
        if self.errors:
            self.state, self.result, self.due = "off", "disarmed", -1
        elif self.state == "off":
            self.result = "busy"
            self.later("on")

    def pass_time(self) -> None:
        was = self.state
        super().pass_time()
        if was != self.state:
            self.result = "success" if self.state == "on" else "disarmed"
            self.fed = self.now if self.state == "on" else self.fed

    def disable(self) -> None:
        self.result = "cancelled" if self.state == "on" else "success"
        self.state, self.due = "off", -1

    def clear(self) -> None:
        self.errors = []

    def torque(self) -> None:
        self.fed = self.now

    def fail(self, error: str) -> None:
        before = self.errors
        super().fail(error)
        self.errors = sorted({*before, error})
        self.result = "disarmed"

    def words(self) -> tuple[int, int, int]:
        """Axis error, axis state, procedure result of a heartbeat."""
        codes = {"watchdog": 0x1000000, "current": 0x400}
        results = {"success": 0, "busy": 1, "cancelled": 2, "disarmed": 3}
        error = sum(codes[name] for name in self.errors)
        return error, 8 if self.state == "on" else 1, results[self.result]


#: Commands of a control word: mask, bits (CiA 402-2, table of commands).
COMMANDS = {
    "shutdown": (0x87, 0x06), "switch on": (0x8F, 0x07), "enable": (0x8F, 0x0F),
    "disable voltage": (0x82, 0x00), "quick stop": (0x86, 0x02),
}  # fmt: skip
#: Transitions by command; the numbers are those of the standard.
TRANSITIONS = {
    ("switch on disabled", "shutdown"): "ready",  # 2
    ("ready", "switch on"): "switched on",  # 3
    ("ready", "enable"): "switched on",  # 3, and 4 at the next cycle
    ("switched on", "enable"): "on",  # 4
    ("on", "switch on"): "switched on",  # 5
    ("switched on", "shutdown"): "ready",  # 6
    ("ready", "quick stop"): "switch on disabled",  # 7
    ("ready", "disable voltage"): "switch on disabled",  # 7
    ("on", "shutdown"): "ready",  # 8
    ("on", "disable voltage"): "switch on disabled",  # 9
    ("switched on", "disable voltage"): "switch on disabled",  # 10
    ("switched on", "quick stop"): "switch on disabled",  # 10
    ("on", "quick stop"): "quick stop active",  # 11
    ("quick stop active", "disable voltage"): "switch on disabled",  # 12
}
#: State, mask and bits of a status word.
STATUS = {
    "switch on disabled": (0x4F, 0x40), "ready": (0x6F, 0x21), "switched on": (0x6F, 0x23),
    "on": (0x6F, 0x27), "quick stop active": (0x6F, 0x07), "reaction": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}  # fmt: skip


class CiA402(Oracle):
    """A transition a cycle, by the control word of then; operational only by NMT."""

    nmt = "pre-operational"
    word = seen = 0
    fresh = monitored = False
    ends = -1  # of a quick stop or a fault reaction
    born = 0  # its cycles count from its power-up

    def begin(self) -> None:
        super().begin()
        self.state, self.nmt, self.word, self.seen = "switch on disabled", "pre-operational", 0, 0
        self.fresh, self.monitored, self.ends, self.born = False, False, -1, self.now

    def control(self, word: int) -> None:
        if self.nmt == "operational":
            self.word, self.fresh = word, True

    def beat(self) -> None:
        self.monitored, self.fed = True, self.now

    def start(self) -> None:
        self.nmt = "operational"

    def sync(self) -> None:
        self.answers += self.nmt == "operational"

    def fail(self, error: str) -> None:
        self.errors.append(error)
        if self.state not in ("reaction", "fault"):
            self.state, self.ends = "reaction", self.now + REACTION

    def pass_time(self) -> None:
        if self.monitored and self.now - self.fed > WATCHDOG:
            self.monitored = False
            self.fail("watchdog")
            self.nmt, self.answers = "pre-operational", 0
        if self.ends == self.now:
            stands = {"reaction": "fault", "quick stop active": "switch on disabled"}
            self.state, self.ends = stands.get(self.state, self.state), -1
        if (self.now - self.born) % CYCLE == 0 and self.fresh:
            self.cycle()

    def cycle(self) -> None:
        before, self.seen = self.seen, self.word
        if self.state == "fault" and self.word & 0x80 and not before & 0x80:
            self.state, self.errors = "switch on disabled", []
            return
        said = [name for name, (mask, bits) in COMMANDS.items() if self.word & mask == bits]
        after = next(
            (TRANSITIONS[self.state, n] for n in said if (self.state, n) in TRANSITIONS), ""
        )
        self.fresh = bool(after)
        self.state = after or self.state
        if after == "quick stop active":
            self.ends = self.now + QUICK
