"""The state machines of FMI 2.0.5 (3.2.3 model exchange, 4.2.4 co-simulation) over a list of calls.

Written from the tables of the standard, and used for calls that were recorded elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from tests.fmi.described import Described, Known
from tests.fmi.watch import Call

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
INST, N, E, C, S, F, X, P, T = (
    "Instantiated", "Initialization Mode", "Event Mode", "Continuous-Time Mode", "stepComplete",
    "stepFailed", "error", "stepInProgress", "terminated",
)  # fmt: skip
ANY = {INST, N, E, C, S, F, X, T}
RUNNING = {N, E, C, S, F, X, T}
_TYPES = ("Real", "Integer", "Boolean", "String")
#: In which states a function may be called; those of getting and setting depend on the variable.
ALLOWED: dict[str, set[str]] = {
    "GetTypesPlatform": ANY | {P}, "GetVersion": ANY | {P}, "SetDebugLogging": ANY | {P},
    "SetupExperiment": {INST}, "EnterInitializationMode": {INST}, "ExitInitializationMode": {N},
    "Terminate": {E, C, S, F}, "Reset": ANY, "FreeInstance": ANY,
    "GetFMUstate": ANY, "SetFMUstate": ANY, "FreeFMUstate": ANY, "SerializedFMUstateSize": ANY,
    "SerializeFMUstate": ANY, "DeSerializeFMUstate": ANY, "GetDirectionalDerivative": RUNNING,
    "EnterEventMode": {E, C}, "NewDiscreteStates": {E}, "EnterContinuousTimeMode": {E},
    "CompletedIntegratorStep": {C}, "SetTime": {E, C}, "SetContinuousStates": {C},
    "GetEventIndicators": {N, E, C, X, T}, "GetContinuousStates": {N, E, C, X, T},
    "GetDerivatives": {N, E, C, X, T}, "GetNominalsOfContinuousStates": {INST, N, E, C, X, T},
    "SetRealInputDerivatives": {INST, N, S}, "GetRealOutputDerivatives": {S, F, X, T},
    "DoStep": {S}, "CancelStep": {P},
    **{f"Get{kind}Status": {S, F, P, T} for kind in ("", *_TYPES)},
    **{f"Get{kind}": RUNNING for kind in _TYPES},
    **{f"Set{kind}": {INST, N, E, C, S} for kind in _TYPES},
}  # fmt: skip
NEXT = {
    "EnterInitializationMode": N, "EnterEventMode": E, "EnterContinuousTimeMode": C,
    "Terminate": T, "Reset": INST,
}  # fmt: skip


def violations(calls: Iterable[Call], known: Described) -> list[str]:
    """Calls that the standard does not allow, each as a sentence."""
    instances: dict[int, Instance] = {}
    found: list[str] = []
    dead = False
    for at, call in enumerate(calls):

        def wrong(what: str, call: Call = call, at: int = at) -> None:
            found.append(f"call {at}, {call}: {what}")

        if dead:
            wrong("after fatal")
        if call.name == "Instantiate" and call.instance:
            instances[call.instance] = Instance(known, int(call.said["fmuType"]) == 0)
        elif call.instance in instances:
            instances[call.instance].called(call, wrong)
            dead = dead or call.status == FATAL
            if call.name == "FreeInstance":
                del instances[call.instance]
        elif call.instance:
            wrong("of an instance that does not exist")
    if not dead:
        found += [f"an instance in {x.state} was not freed" for x in instances.values()
                  if x.state != P]  # fmt: skip
    return found


class Instance:
    """One instance and the state it is in."""

    def __init__(self, known: Described, exchange: bool) -> None:
        self.known, self.exchange, self.state = known, exchange, INST
        self.setups, self.time, self.event = 0, 0.0, 0.0
        self.latest = float("-inf")  # no state before will be set
        self.saved: dict[int, dict[str, Any]] = {}
        self.next: float | None = None  # time event that was announced
        self.more = self.ending = self.failed = self.set_since_step = False
        self.flags = known.flags["ModelExchange" if exchange else "CoSimulation"]

    def called(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.state not in ALLOWED.get(call.name, set()):
            wrong(f"not allowed in {self.state}")
        check = getattr(self, f"_{call.name}", None)
        if check is not None:
            check(call, wrong)
        elif call.name.removeprefix("Set") in _TYPES:
            self._set(call, wrong)
        elif call.name.removeprefix("Get") in _TYPES:
            self._get(call, wrong)
        self._changed(call)

    def _changed(self, call: Call) -> None:
        self.failed = self.failed or call.status not in (OK, WARNING, None)
        if call.status == ERROR or call.status not in (*range(6), None):
            self.state = X
        elif call.name == "DoStep" and call.status in (DISCARD, PENDING):
            self.state = F if call.status == DISCARD else P
        elif call.name == "ExitInitializationMode":
            self.state, self.more = (E if self.exchange else S), True
        elif call.status in (OK, WARNING):
            self.state = NEXT.get(call.name, self.state)

    # ---- values -----------------------------------------------------------------------------

    def _set(self, call: Call, wrong: Callable[[str], None]) -> None:
        kind = call.name.removeprefix("Set")
        for reference in call.said["vr"]:
            variables = self.known.of(kind, reference)
            if not any(self._settable(v, kind) for v in variables):
                names = ", ".join(v.name for v in variables) or f"{kind} {reference}, no variable"
                wrong(f"{names} may not be set in {self.state}")
        self.set_since_step = self.state == S

    def _settable(self, v: Known, kind: str) -> bool:
        if v.variability == "constant":
            return False
        if self.state == INST:
            return v.initial in ("exact", "approx")
        if self.state == N:
            return v.initial == "exact" or v.causality == "input"
        if self.state == C:
            return kind == "Real" and v.causality == "input" and v.variability == "continuous"
        return v.causality == "input" or (v.parameter and v.variability == "tunable")

    def _get(self, call: Call, wrong: Callable[[str], None]) -> None:
        kind = call.name.removeprefix("Get")
        for reference in call.said["vr"]:
            variables = self.known.of(kind, reference)
            if not variables:
                wrong(f"{kind} {reference} is no variable")
            elif self.state == N and not any(v.unknown or _may_be_a_state(v) for v in variables):
                wrong(f"{variables[0].name} may not be read in {self.state}")
        if self.state == S and self.set_since_step:
            wrong("read after values were set, without a step between")

    # ---- start and end ----------------------------------------------------------------------

    def _SetupExperiment(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.setups += 1
        self.time = self.event = call.said["startTime"]
        if self.setups > 1:
            wrong("called twice")

    def _EnterInitializationMode(self, call: Call, wrong: Callable[[str], None]) -> None:
        if not self.setups:
            wrong("SetupExperiment was not called")

    def _FreeInstance(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.state in (E, C, S) and not self.failed:
            wrong("not terminated before")

    def _Reset(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.setups, self.ending, self.set_since_step = 0, False, False

    # ---- capabilities -----------------------------------------------------------------------

    def _GetFMUstate(self, call: Call, wrong: Callable[[str], None]) -> None:
        if "canGetAndSetFMUstate" not in self.flags:
            wrong("the FMU cannot get and set its state")
        elif call.status in (OK, WARNING):
            self.saved[call.said["saved"]] = {k: v for k, v in vars(self).items() if k != "saved"}

    def _SetFMUstate(self, call: Call, wrong: Callable[[str], None]) -> None:
        latest = self.latest
        if call.said["saved"] not in self.saved:
            wrong("a state that was not saved")
            return
        vars(self).update(self.saved[call.said["saved"]])
        self.set_since_step = False
        if self.time < latest:
            wrong(f"goes back to {self.time!r}; no state before {latest!r} was to be set")

    def _GetDirectionalDerivative(self, call: Call, wrong: Callable[[str], None]) -> None:
        if "providesDirectionalDerivative" not in self.flags:
            wrong("the FMU provides no directional derivatives")

    def _SetRealInputDerivatives(self, call: Call, wrong: Callable[[str], None]) -> None:
        if "canInterpolateInputs" not in self.flags:
            wrong("the FMU cannot interpolate its inputs")

    # ---- co-simulation ----------------------------------------------------------------------

    def _DoStep(self, call: Call, wrong: Callable[[str], None]) -> None:
        t, h = call.said["currentCommunicationPoint"], call.said["communicationStepSize"]
        if not h > 0.0:
            wrong("the step is not positive")
        if abs(t - self.time) > 1e-9 * max(1.0, abs(t)):
            wrong(f"the time is not {self.time!r}, where the step before ended")
        if call.said.get("noSetFMUStatePriorToCurrentPoint"):
            self.latest = t
        self.time, self.set_since_step = t + h, False

    # ---- model exchange ---------------------------------------------------------------------

    def _NewDiscreteStates(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.ending:
            wrong("the FMU has asked to end the simulation")
        self.more = bool(call.said["newDiscreteStatesNeeded"])
        self.ending = bool(call.said["terminateSimulation"])
        self.next = call.said["nextEventTime"] if call.said["nextEventTimeDefined"] else None
        self.event = self.time

    def _EnterEventMode(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.more, self.event = True, self.time
        if self.ending:
            wrong("the FMU has asked to end the simulation")

    def _EnterContinuousTimeMode(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.more:
            wrong("the event iteration has not ended")
        if self.ending:
            wrong("the FMU has asked to end the simulation")

    def _SetTime(self, call: Call, wrong: Callable[[str], None]) -> None:
        t = self.time = call.said["time"]
        if t < self.event:
            wrong(f"goes back behind the event at {self.event!r}")
        if self.next is not None and t > self.next + 1e-9 * max(1.0, abs(t)):
            wrong(f"goes over the time event at {self.next!r}")

    def _CompletedIntegratorStep(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.ending = self.ending or bool(call.said["terminateSimulation"])


def _may_be_a_state(v: Known) -> bool:
    """States may be read in Initialization Mode, but a co-simulation FMU need not name them."""
    return v.causality == "local" and v.variability == "continuous" and v.initial == "exact"
