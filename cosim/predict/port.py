"""The port that is analysed: where the operator holds the robot, and the far end.

Names of signals come from the scenario's ``[analysis]``; what it leaves out follows from the arm's
facts, or from the names that arms here go by (``tau_h``, ``q``, ``dq``, ``tau_ext``, ``tau_e``).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from cosim.base.errors import ScenarioError
from cosim.predict.facts import Arm
from cosim.predict.inputs import is_driven
from cosim.predict.network import network
from cosim.predict.system import AnalyzedSystem
from cosim.scenario.connect import unknown
from cosim.scenario.spec import AnalysisSpec


@dataclass(frozen=True, slots=True)
class PortSignals:
    """Names of signals, "" where there is none; `arm`, `far` are the components they belong to.

    The force on the robot is the signal `force` plus the input `external`, which other components
    feed; `response` is its position and `rate` its velocity; `inject` is the input of a test force.
    The torque of the far robot on its environment is `far_force` less `far_external`, with
    `far_response` and `far_rate`. `estimates`: theta_hat of each robot of the network around the
    port, in its order; `members`: their positions, where there is more than one.
    """

    arm: str
    force: str
    response: str
    rate: str = ""
    inject: str = ""
    external: str = ""
    far: str = ""
    far_force: str = ""
    far_response: str = ""
    far_rate: str = ""
    far_external: str = ""
    estimates: tuple[str, ...] = ()
    members: tuple[str, ...] = ()

    @property
    def collocated(self) -> bool:
        """True if force goes in where a position is measured: only then has it power."""
        same = self.inject.split(".")[0] == self.response.split(".")[0]
        return same and self.response != self.rate

    def signals(self) -> tuple[str, ...]:
        """Names of what is recorded of it."""
        names = (
            *(self.force, self.external, self.response, self.rate),
            *(self.far_force, self.far_external, self.far_response, self.far_rate),
            *self.members,
            *self.estimates,
        )
        return tuple(dict.fromkeys(name for name in names if name))


#: What ports of an arm are called where no facts say so.
_NAMES = ("tau_h", "q", "dq", "tau_ext", "tau_e")


def port_of(
    spec: AnalysisSpec, known: Collection[str], system: AnalyzedSystem | None, chosen: str = "",
    place: str = "",
) -> PortSignals:  # fmt: skip
    """The port that `spec` names, that of the arm `chosen`, or of the only arm that is held.

    `known`: names of the signals there are. Raises ScenarioError at `place` where it takes more to
    know which, or a signal is not there.
    """
    arm = chosen or _component(spec.force or spec.response or spec.inject) or _held(system, place)
    if not any(name.startswith(f"{arm}.") for name in known):
        components = {name.split(".")[0] for name in known}
        raise ScenarioError(unknown(arm, components, "component with signals"), place)
    hand, q, dq, external, _ = _names(system, arm)
    far = _component(spec.far_response or spec.far_force) or _far(system, arm)
    _, far_q, far_dq, far_external, environment = _names(system, far)
    pick = _picker(known, place)
    own = spec if chosen in ("", _component(spec.force or spec.response)) else AnalysisSpec()
    return PortSignals(
        arm=arm,
        force=pick(own.force, f"{arm}.{hand}", True),
        response=pick(own.response, f"{arm}.{q}", True),
        rate=pick(own.rate, f"{arm}.{dq}"),
        inject=pick(own.inject, f"{arm}.{external}"),
        external=_acting(own.force, f"{arm}.{hand}", f"{arm}.{external}", known, system),
        far=far,
        far_force=pick(own.far_force, f"{far}.{environment}"),
        far_response=pick(own.far_response, f"{far}.{far_q}"),
        far_rate=pick(own.far_rate, f"{far}.{far_dq}"),
        far_external=_acting(
            own.far_force, f"{far}.{environment}", f"{far}.{far_external}", known, system
        ),
        estimates=_estimates(system, arm),
        members=_members(system, arm) if own.response in ("", f"{arm}.{q}") else (),
    )


def _acting(
    given: str, usual: str, external: str, known: Collection[str], system: AnalyzedSystem | None
) -> str:
    """The input `external` if it is connected; "" if `given` is a separate force."""
    if given not in ("", usual):
        return ""
    there = external in known if system is None else is_driven(system.plan, external)
    return external if there else ""


def _picker(known: Collection[str], place: str) -> Callable[..., str]:
    def pick(given: str, usual: str, needed: bool = False) -> str:
        """`given`, which must exist; else `usual`, if it exists."""
        if given and given not in known:
            raise ScenarioError(unknown(given, known, "signal"), place)
        if given or usual in known:
            return given or usual
        if needed:
            raise ScenarioError(
                f"no signal {usual!r}; name the port's signals in [analysis]: force, response, rate"
                " and inject",
                place,
            )
        return ""

    return pick


def _component(signal: str) -> str:
    return signal.split(".")[0]


def _held(system: AnalyzedSystem | None, place: str) -> str:
    held = system.held() if system is not None else ()
    if len(held) == 1:
        return held[0]
    arms = ", ".join(sorted(system.arms)) if system is not None else ""
    found = f"{', '.join(held)} are held" if held else "no arm is held by an operator"
    raise ScenarioError(
        f"the port is not defined: {found}; expected --port NAME, or [analysis] with force, "
        "response and inject" + (f" (arms: {arms})" if arms else ""),
        place,
    )


def _far(system: AnalyzedSystem | None, arm: str) -> str:
    """The other of two arms."""
    others = [name for name in (system.arms if system is not None else ()) if name != arm]
    return others[0] if len(others) == 1 else ""


def _estimates(system: AnalyzedSystem | None, arm: str) -> tuple[str, ...]:
    """The signals theta_hat of the laws around `arm`; none where one of them has none."""
    net = network(system, arm) if system is not None else None
    if system is None or net is None:
        return ()
    slots = system.plan.slots()
    names = tuple(f"{n}.{law.estimate}" for n, law in zip(net.names, net.laws, strict=True))
    return names if all(name in slots for name in names) else ()


def _members(system: AnalyzedSystem | None, arm: str) -> tuple[str, ...]:
    """The positions of all robots of the network around `arm`; none where it is alone."""
    net = network(system, arm) if system is not None else None
    if system is None or net is None or len(net.names) == 1:
        return ()
    arms = [system.arm_of(name) or "" for name in net.names]
    return tuple(f"{name}.{system.arms[name].position}" for name in arms)


def _names(system: AnalyzedSystem | None, name: str) -> tuple[str, str, str, str, str]:
    arm = system.arms.get(name) if system is not None else None
    if not isinstance(arm, Arm):
        return _NAMES
    return arm.hand, arm.position, arm.rate, arm.external, arm.environment
