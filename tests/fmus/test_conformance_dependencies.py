"""The dependencies an FMU declares are those it has: found by changing every input and start."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pytest

from fmus.build.archive import Version, find, shipped_models
from fmus.build.kernel import library, load
from fmus.build.source import scalars
from fmus.model import Model
from fmus.models import planar2r

#: Limits that are out of reach by default.
WITHIN_REACH = {"tau_max": (0.1, 100.0), "age_max": (0.1, 1.0), "age_fade": (0.1, 1.0)}
#: Entries beside a diagonal, small enough for a positive definite matrix.
OFF_DIAGONAL = {"K_off": 0.1, "Gamma_off": 0.001}
#: Entries of rotations and of a body, which random numbers would not be, and a rate that needs
#: estimates of bodies.
TOGETHER = ("rotation", "frame", "inertia", "natural")
#: A small change, and one that crosses a limit; of a rotation, one that leaves it a rotation.
CHANGES = {"real": (0.01, 0.95), "integer": (1.0,), "boolean": ()}
CHANGES_OF = {"rotation": (1e-7,), "frame": (1e-7,)}
POINTS = 40
Pairs = set[tuple[str, str]]


class Probe:
    """Which scalars change an output, found by changing them one by one at random points."""

    def __init__(self, model: Model, in_steps: bool) -> None:
        self.model, self.in_steps = model, in_steps
        self.library = load(library(model))
        variables = [(v, name) for v in model.variables for name in scalars(v)]
        self.names = [name for _, name in variables]
        self.unknowns = [
            n
            for n, (v, _) in enumerate(variables)
            if v.causality == "output" and (in_steps or not v.settable)
        ]
        self.knowns = [
            (n, CHANGES_OF.get(v.name, CHANGES[v.type]))
            for n, (v, _) in enumerate(variables)
            if v.causality == "input"
            or (not in_steps and (v.causality == "parameter" or v.settable))
        ]

    def evaluate(self, x: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        """All variables at the start or after one step; None where that is refused.

        A step begins from what `start` begins with, and inputs of `x`: what an output owes to the
        inputs of the start is no dependency of the step.
        """
        y = (start if self.in_steps else x).copy()
        if self.library.kernel_initial(y.ctypes.data):
            return None
        if self.in_steps:
            inputs = [known for known, _ in self.knowns]
            y[inputs] = x[inputs]
        if self.in_steps and self.library.kernel_step(y.ctypes.data, 0.0, self.model.step):
            return None
        return y

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A random point; some parameters, by chance, at their default, which may be off."""
        values = []
        for v in self.model.variables:
            start, more = np.array(v.starts), rng.uniform(0.1, 1.0, v.size)
            near = np.where(start == 0.0, more, start * (1 + 0.1 * more))
            if v.name in WITHIN_REACH:
                low, high = WITHIN_REACH[v.name]
                near = low * (high / low) ** more
            if v.name == "q_w":
                near -= 2.0  # so that the arm is in the wall
            if v.name in ("q_min", "q_max") and self.model.identifier.startswith("arm_task"):
                near = more  # so that some joints are near a limit, and others not
            if v.name in OFF_DIAGONAL:
                near = OFF_DIAGONAL[v.name] * more
            still = v.type != "real" or (v.causality == "parameter" and rng.random() < 0.4)
            still = still or v.name in TOGETHER
            values.append(start if still else near)
        return np.concatenate(values)

    def dependencies(self) -> Pairs:
        """(output scalar, known scalar) of every change seen."""
        found, rng = set(), np.random.default_rng(11)
        for _ in range(POINTS):
            x = self.draw(rng)
            base = self.evaluate(x, x)
            assert base is not None
            for known, changes in self.knowns:
                for change in changes:
                    other = x.copy()
                    other[known] += change
                    y = self.evaluate(other, x)
                    if y is not None:
                        changed = [n for n in self.unknowns if y[n] != base[n]]
                        found |= {(self.names[n], self.names[known]) for n in changed}
        return found


def described(model: Model, version: Version) -> ElementTree.Element:
    with ZipFile(find(model, version)) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


def declared(model: Model, group: str) -> Pairs:
    """(unknown, known) in a group of FMI 2.0's ModelStructure, scalars by name."""
    root = described(model, "2.0")
    names = [v.get("name", "") for v in root.iterfind("ModelVariables/*")]
    return {
        (names[int(unknown.get("index", "0")) - 1], names[int(known) - 1])
        for unknown in root.iterfind(f"ModelStructure/{group}/Unknown")
        for known in unknown.get("dependencies", "").split()
    }


def by_variable(pairs: Iterable[tuple[str, str]]) -> Pairs:
    return {(a.partition("[")[0], b.partition("[")[0]) for a, b in pairs}


#: Ends of a line, differences of positions, and the least singular value (0 in places): what they
#: give depends on inputs through what earlier steps moved and counted, or elsewhere, so not all of
#: it shows at the start; ``test_rivals_parity``, ``test_encoder`` and ``test_arm_task`` find it.
LATER = {
    "wave_admittance", "wave_integral_impedance", "wave_integral_admittance", "tdpa_impedance",
    "tdpa_admittance", "encoder", "servo", "servo_command", "kinematic",
    "arm_task", "arm_task_turn",
}  # fmt: skip


@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
def test_initial_unknowns_depend_on_what_is_declared_and_on_nothing_else(model: Model) -> None:
    seen, said = Probe(model, in_steps=False).dependencies(), declared(model, "InitialUnknowns")
    assert seen <= said
    assert by_variable(seen) == by_variable(said) or model.identifier in LATER


@pytest.mark.parametrize(
    "model",
    [m for m in shipped_models() if m.kind == "sampled"],
    ids=lambda model: model.identifier,
)
def test_outputs_of_sampled_models_depend_on_the_inputs_declared(model: Model) -> None:
    seen, said = Probe(model, in_steps=True).dependencies(), declared(model, "Outputs")
    assert seen <= said
    assert by_variable(seen) == by_variable(said) or model.identifier in LATER


def test_the_motion_of_the_arm_does_not_depend_on_inputs_directly() -> None:
    moved = {unknown for unknown, _ in by_variable(declared(planar2r.model(), "Outputs"))}
    assert not moved & {"q", "dq"}


@pytest.mark.parametrize("model", shipped_models(), ids=lambda model: model.identifier)
def test_fmi3_declares_the_same_dependencies_by_variable(model: Model) -> None:
    root = described(model, "3.0")
    names = [v.get("name", "") for v in root.iterfind("ModelVariables/*")]
    for tag, group in (("Output", "Outputs"), ("InitialUnknown", "InitialUnknowns")):
        found = {
            (names[int(unknown.get("valueReference", "-1"))], names[int(known)])
            for unknown in root.iterfind(f"ModelStructure/{tag}")
            for known in unknown.get("dependencies", "").split()
        }
        assert found == by_variable(declared(model, group))
