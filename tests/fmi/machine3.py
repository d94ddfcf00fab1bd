"""The state machines of FMI 3.0.2 (2.3 common, 3.2, 4.2, 5.2) over a list of calls.

Written from the lists of allowed calls in the standard, and used for calls that were recorded
elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from tests.fmi.described import Described, Known
from tests.fmi.watch import Call

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
INST, G, N, E, C, S, D, R, A, T = (
    "Instantiated", "Configuration Mode", "Initialization Mode", "Event Mode",
    "Continuous-Time Mode", "Step Mode", "Step Discarded", "Reconfiguration Mode",
    "Clock Activation Mode", "Terminated",
)  # fmt: skip
ANY = {INST, G, N, E, C, S, D, R, A, T}
RUNNING = {N, E, C, S, D, A, T}
_TYPES = (
    *("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64"),
    *("UInt64", "Boolean", "String", "Binary"),
)
_STATES = ("GetFMUState", "SetFMUState", "FreeFMUState", "SerializedFMUStateSize",
           "SerializeFMUState", "DeserializeFMUState")  # fmt: skip
ALLOWED: dict[str, set[str]] = {
    "GetVersion": ANY, "SetDebugLogging": ANY, "FreeInstance": ANY, "Reset": ANY,
    **{name: ANY for name in _STATES},
    "EnterConfigurationMode": {INST, E, S, A}, "ExitConfigurationMode": {G, R},
    "EnterInitializationMode": {INST}, "ExitInitializationMode": {N}, "Terminate": {E, C, S, D, A},
    "GetNumberOfContinuousStates": {INST, G, N, E, C},
    "GetNumberOfEventIndicators": {INST, G, N, E, C},
    "GetNumberOfVariableDependencies": ANY, "GetVariableDependencies": ANY,
    "GetDirectionalDerivative": RUNNING, "GetAdjointDerivative": RUNNING,
    "GetContinuousStates": {N, E, C, T}, "GetNominalsOfContinuousStates": {N, E, C, T},
    "GetContinuousStateDerivatives": {N, E, C, T}, "GetEventIndicators": {N, E, C, T},
    "UpdateDiscreteStates": {E}, "EvaluateDiscreteStates": {E}, "SetClock": {E},
    "GetClock": {E, A}, "EnterEventMode": {C, S}, "EnterStepMode": {E},
    "EnterContinuousTimeMode": {E}, "SetTime": {C}, "SetContinuousStates": {C},
    "CompletedIntegratorStep": {C}, "DoStep": {S}, "GetOutputDerivatives": {S, D, T},
    "ActivateModelPartition": {A},
    **{f"{x}{y}{z}": {INST, N, E, A} for x in ("Get", "Set") for y in ("Interval", "Shift")
       for z in ("Decimal", "Fraction")},
    **{f"Get{kind}": RUNNING | {INST} for kind in _TYPES},
    **{f"Set{kind}": {INST, G, N, E, C, S, R, A} for kind in _TYPES},
}  # fmt: skip
NEXT = {
    "EnterInitializationMode": N, "EnterEventMode": E, "EnterStepMode": S,
    "EnterContinuousTimeMode": C, "Terminate": T, "Reset": INST,
}  # fmt: skip
_KINDS = {"ModelExchange": E, "CoSimulation": S, "ScheduledExecution": A}


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
        if call.name.startswith("Instantiate") and call.instance:
            kind = call.name.removeprefix("Instantiate")
            instances[call.instance] = Instance(known, kind, call.said)
        elif call.instance in instances:
            instances[call.instance].called(call, wrong)
            dead = dead or call.status == FATAL
            if call.name == "FreeInstance":
                del instances[call.instance]
        elif call.instance:
            wrong("of an instance that does not exist")
    if not dead:
        found += [f"an instance in {x.state} was not freed" for x in instances.values()]
    return found


class Instance:
    """One instance and the state it is in."""

    def __init__(self, known: Described, kind: str, said: dict[str, Any]) -> None:
        self.known, self.kind, self.state = known, kind, INST
        self.events = bool(said.get("eventModeUsed"))
        self.intermediate = set(said.get("requiredIntermediateVariables", ()))
        self.time, self.event, self.next = 0.0, 0.0, None
        self.latest = float("-inf")  # no state before will be set
        self.saved: dict[int, dict[str, Any]] = {}
        self.more = self.ending = self.failed = False
        self.needs_event = self.set_since_step = False
        self.active: set[int] = set()  # clocks in this Event Mode
        self.activations: dict[int, float] = {}
        self.flags = known.flags.get(kind, set())

    def called(self, call: Call, wrong: Callable[[str], None]) -> None:
        if call.depth:
            self._inside(call, wrong)
            return
        if self.state not in ALLOWED.get(call.name, set()):
            wrong(f"not allowed in {self.state}")
        if self.kind == "ScheduledExecution" and call.name in (
            "EnterEventMode", "UpdateDiscreteStates", "DoStep", "EnterStepMode"):  # fmt: skip
            wrong("not for scheduled execution")
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
        if call.status == ERROR or call.status not in (*range(5), None):
            self.state = T
        elif call.name == "DoStep" and call.status == DISCARD:
            self.state = D
        elif call.status not in (OK, WARNING):
            return
        elif call.name == "ExitInitializationMode":
            self.state = E if self.events else _KINDS[self.kind]
            self.more = True
        elif call.name == "EnterConfigurationMode":
            self.state = G if self.state == INST else R
        elif call.name == "ExitConfigurationMode":
            self.state = INST if self.state == G else E if self.kind == "ModelExchange" else S
        else:
            self.state = NEXT.get(call.name, self.state)

    def _inside(self, call: Call, wrong: Callable[[str], None]) -> None:
        """A call from within a callback: intermediate update, or a clock that ticks (SE)."""
        what = call.name[3:]
        if self.kind == "ScheduledExecution":
            if what not in ("Clock", "IntervalDecimal", "IntervalFraction", *_TYPES):
                wrong("not allowed in a callback")
        elif what not in (*_TYPES, "OutputDerivatives"):
            wrong("not allowed in Intermediate Update Mode")
        elif set(call.said["valueReferences"]) - self.intermediate:
            wrong("not among the intermediate variables that were asked for")

    # ---- values -----------------------------------------------------------------------------

    def _set(self, call: Call, wrong: Callable[[str], None]) -> None:
        kind = call.name.removeprefix("Set")
        for reference in call.said["valueReferences"]:
            variables = self.known.of(kind, reference)
            if not any(self._settable(v) for v in variables):
                names = ", ".join(v.name for v in variables) or f"{kind} {reference}, no variable"
                wrong(f"{names} may not be set in {self.state}")
        self.set_since_step = self.state in (S, A)

    def _settable(self, v: Known) -> bool:
        structural = v.causality == "structuralParameter"
        if v.variability == "constant" or structural != (self.state in (G, R)):
            return False
        if self.state in (G, R):
            return self.state == G or v.variability == "tunable"
        if self.state == INST:
            return v.initial in ("exact", "approx")
        if self.state == N:
            return v.initial == "exact"
        if self.state == C or (self.state == S and self.events):
            return v.causality == "input" and v.variability == "continuous"
        if self.state == E and v.causality == "input" and v.clocks:
            return bool(self.active & set(v.clocks))
        return v.causality == "input" or (v.parameter and v.variability == "tunable")

    def _get(self, call: Call, wrong: Callable[[str], None]) -> None:
        kind = call.name.removeprefix("Get")
        for reference in call.said["valueReferences"]:
            variables = self.known.of(kind, reference)
            if not variables:
                wrong(f"{kind} {reference} is no variable")
            elif self.state == E and self._resting(variables[0]):
                wrong(f"{variables[0].name} is read, but none of its clocks is active")
        if self.state in (S, A) and self.set_since_step:
            wrong("read after values were set, without a step between")

    def _resting(self, v: Known) -> bool:
        clocked = v.causality == "output" and v.clocks
        return bool(clocked) and not self.active & set(v.clocks)

    def _GetFMUState(self, call: Call, wrong: Callable[[str], None]) -> None:
        if "canGetAndSetFMUState" not in self.flags:
            wrong("the FMU cannot get and set its state")
        elif call.status in (OK, WARNING):
            kept = {k: v for k, v in vars(self).items() if k != "saved"}
            self.saved[call.said["saved"]] = {**kept, "active": set(self.active)}

    def _SetFMUState(self, call: Call, wrong: Callable[[str], None]) -> None:
        latest = self.latest
        if call.said["saved"] not in self.saved:
            wrong("a state that was not saved")
            return
        vars(self).update(self.saved[call.said["saved"]])
        self.active, self.set_since_step = set(self.active), False
        if self.time < latest:
            wrong(f"goes back to {self.time!r}; no state before {latest!r} was to be set")

    def _GetDirectionalDerivative(self, call: Call, wrong: Callable[[str], None]) -> None:
        if "providesDirectionalDerivatives" not in self.flags:
            wrong("the FMU provides no directional derivatives")

    # ---- start and end ----------------------------------------------------------------------

    def _EnterInitializationMode(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.time = self.event = call.said["startTime"]

    def _FreeInstance(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.state in (E, C, S, A) and not self.failed:
            wrong("not terminated before")

    # ---- events -----------------------------------------------------------------------------

    def _EnterEventMode(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.kind == "CoSimulation" and not self.events:
            wrong("event mode is not used")
        if self.ending:
            wrong("the FMU has asked to end the simulation")
        self.more, self.needs_event, self.event = True, False, self.time
        self.active = set()

    def _SetClock(self, call: Call, wrong: Callable[[str], None]) -> None:
        for reference, on in zip(call.said["valueReferences"], call.said["values"], strict=True):
            variables = self.known.of("Clock", reference)
            if not variables or variables[0].causality != "input":
                wrong(f"{reference} is no input clock")
            (self.active.add if on else self.active.discard)(reference)

    def _GetClock(self, call: Call, wrong: Callable[[str], None]) -> None:
        said = zip(call.said["valueReferences"], call.said["values"], strict=True)
        self.active |= {reference for reference, on in said if on}

    def _UpdateDiscreteStates(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.ending:
            wrong("the FMU has asked to end the simulation")
        self.more = bool(call.said["discreteStatesNeedUpdate"])
        self.ending = bool(call.said["terminateSimulation"])
        self.next = call.said["nextEventTime"] if call.said["nextEventTimeDefined"] else None
        self.active, self.event = set(), self.time

    def _left(self, call: Call, wrong: Callable[[str], None]) -> None:
        if self.more:
            wrong("the event iteration has not ended")
        if self.ending:
            wrong("the FMU has asked to end the simulation")
        other = "CoSimulation" if call.name == "EnterStepMode" else "ModelExchange"
        if self.kind != other:
            wrong(f"for {other} only")
        self.set_since_step = False

    _EnterStepMode = _EnterContinuousTimeMode = _left

    # ---- co-simulation ----------------------------------------------------------------------

    def _DoStep(self, call: Call, wrong: Callable[[str], None]) -> None:
        t, h = call.said["currentCommunicationPoint"], call.said["communicationStepSize"]
        if not h > 0.0:
            wrong("the step is not positive")
        if abs(t - self.time) > 1e-9 * max(1.0, abs(t)):
            wrong(f"the time is not {self.time!r}, where the step before ended")
        if self.ending:
            wrong("the FMU has asked to end the simulation")
        if self.needs_event:
            wrong("the FMU has an event, which was not handled")
        if call.said.get("noSetFMUStatePriorToCurrentPoint"):
            self.latest = t
        early = bool(call.said.get("earlyReturn"))
        self.time = call.said["lastSuccessfulTime"] if early else t + h
        self.ending = bool(call.said.get("terminateSimulation"))
        self.needs_event = bool(call.said.get("eventHandlingNeeded")) and self.events
        self.set_since_step = False

    # ---- scheduled execution ----------------------------------------------------------------

    def _ActivateModelPartition(self, call: Call, wrong: Callable[[str], None]) -> None:
        clock, t = int(call.said["clockReference"]), call.said["activationTime"]
        if not t > self.activations.get(clock, float("-inf")):
            wrong(f"the time is not later than that before, {self.activations[clock]!r}")
        self.activations[clock] = t
        self.set_since_step = False

    # ---- model exchange ---------------------------------------------------------------------

    def _SetTime(self, call: Call, wrong: Callable[[str], None]) -> None:
        t = self.time = call.said["time"]
        if t < self.event:
            wrong(f"goes back behind the event at {self.event!r}")
        if self.next is not None and t > self.next + 1e-9 * max(1.0, abs(t)):
            wrong(f"goes over the time event at {self.next!r}")

    def _CompletedIntegratorStep(self, call: Call, wrong: Callable[[str], None]) -> None:
        self.ending = self.ending or bool(call.said["terminateSimulation"])
