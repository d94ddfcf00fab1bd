"""``algorithm = "adaptive"``: its settings, and components that can take part in macro steps."""

from __future__ import annotations

from cosim.base.errors import ScenarioError
from cosim.fmi.components import reason_not_rolled_back
from cosim.scenario.spec import AdaptiveSpec, Scenario
from cosim.schedule.macro import AdaptiveSettings, PowerBond
from cosim.schedule.plan import Plan

#: The absolute tolerance over the relative one, in the unit of each signal.
ABSOLUTE = 0.01


def adaptive_settings(scenario: Scenario) -> AdaptiveSettings | None:
    """The settings of the algorithm, None: it is another one. Raises ScenarioError."""
    spec = scenario.run.adaptive
    if scenario.run.algorithm != "adaptive":
        if spec is not None:
            raise ScenarioError(
                f'found run.algorithm = "{scenario.run.algorithm}", expected "adaptive" for it',
                scenario.place("run.adaptive"),
            )
        return None
    spec = AdaptiveSpec() if spec is None else spec
    smallest = 0.0
    if spec.smallest is not None:
        smallest = scenario.seconds(spec.smallest, "run.adaptive.smallest")
        if not smallest > 0.0:
            raise ScenarioError(
                f"{smallest:g} s must be positive", scenario.place("run.adaptive.smallest")
            )
    absolute = ABSOLUTE * spec.tolerance if spec.absolute is None else spec.absolute
    return AdaptiveSettings(
        spec.tolerance, absolute, smallest, spec.iterations, spec.fixed,
        tuple(PowerBond(b.effort, b.flow) for b in spec.bonds),
    )  # fmt: skip


def check_groups(plan: Plan, scenario: Scenario) -> None:
    """Refuse components in macro steps that cannot do a step again. Raises ScenarioError."""
    steps = [plan.components[i] for group in plan.groups for i in group.components]
    reasons = ((s.name, reason_not_rolled_back(s.component)) for s in steps)
    found = [(name, reason) for name, reason in reasons if reason]
    if found:
        names = ", ".join(f'"{name}"' for name, _ in found)
        said = "; ".join(f"{name} {reason}" for name, reason in found)
        raise ScenarioError(
            f'algorithm = "adaptive" repeats steps of coupled components: {said}. Expected '
            f"run.adaptive.fixed = [{names}], which steps them once in their period",
            scenario.place("run.algorithm"),
        )
