"""The derivatives of one step of a component, by central differences over its start values.

The states are the outputs and local variables of a component whose start values can be set. The
component is started again where the run has it, with one state or input changed, and makes one
step. A state whose start value is the output of the first step itself is seen after the second.
Derivatives are extrapolated from two differences, with the step given and half of it, so that their
error is of order four; how much the two differ tells where a component is not smooth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.errors import CosimError, RunError
from cosim.fmi.components import begin_at, fmu_of, overwrite
from cosim.fmi.failures import sentence
from cosim.fmi.file.ports import REAL
from cosim.schedule.parts import Slot, Step

Matrix = NDArray[np.float64]
#: Relative difference at which a step made again is taken for the one of the run.
AGAIN = 1e-9
#: Relative change of the derivatives from one step to the next that tells a memory that moves.
MOVES = 0.05
#: Steps after which a component that was started again is compared with one that goes on.
AHEAD = 3


class StepDerivatives(Struct, frozen=True):
    """x+ = `A` x + `B` u and y = `C` x + `D` u of one step; y are all outputs after the step.

    Shapes (n, n), (n, m), (p, n), (p, m), in the units of the states (`states`, n scalars in all),
    inputs and outputs of the component. `x0`, (n,), is where it is; `error` how much the
    derivatives changed with the size of the differences, relative to the greatest of them.
    """

    name: str
    states: tuple[Slot, ...]
    x0: Matrix
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    error: float


def state_slots(step: Step, *, every: bool = False) -> tuple[Slot, ...]:
    """Slots of the outputs and locals whose start values can be set: the states.

    `every`: of all outputs and locals that are numbers, of one of our own FMUs.
    """
    fmu, given = fmu_of(step.component), {p.name: p for p in step.component.parameters}

    def is_state(slot: Slot) -> bool:
        if every and fmu is not None:
            return fmu.groups[slot.port].first.type in REAL
        real = slot.port in given and given[slot.port].type == "real"
        if fmu is None or not real:
            return real
        return fmu.groups[slot.port].first.causality in ("output", "local")

    return tuple(slot for slot in step.outputs if is_state(slot))


def step_derivatives(
    step: Step,
    seen: Sequence[Matrix],
    t: float,
    h: float,
    size: float,
    *,
    fed: NDArray[np.bool_] | None = None,
) -> StepDerivatives:
    """The derivatives of the step from `t` of length `h` (s).

    `seen`: signals (n_signals,) before the tick of the step, once its inputs
    are there, and after the step. `size`: the change of a state or an input, in its
    unit, for values up to 1, and relative above. `fed`, (n_signals,): the inputs to which there are
    derivatives, each of one difference; `error` is then the share of the second difference, large
    at an edge. None: of all inputs. One of our own FMUs that does not go on as before
    when it is started with its start values is given all that it remembers. Raises RunError for
    another such component, or one that cannot be stepped here.
    """
    fmu = fmu_of(step.component)
    try:
        try:
            return _derivatives(_Started(step, seen, t, h), size, fed)
        except RunError:
            if fmu is None or not fmu.ours:
                raise
            return _derivatives(_Started(step, seen, t, h, every=True), size, fed)
    except CosimError as error:
        raise RunError(
            f"{step.name}: cannot be linearized at t = {t:.6g} s: {sentence(error, step.name)}",
            component=step.name,
        ) from error
    finally:
        if fmu is not None:
            fmu.close()


def _derivatives(started: _Started, size: float, fed: NDArray[np.bool_] | None) -> StepDerivatives:
    found = started.derivatives(size, fed)
    started.check_goes_on(size)
    started.check_stays(found, size, fed)
    return found


class _Started:
    """A component that is started again and again near one state, and stepped.

    `every`: all outputs and locals of one of our own FMUs are states, and are written where it has
    them.
    """

    def __init__(
        self, step: Step, seen: Sequence[Matrix], t: float, h: float, *, every: bool = False
    ) -> None:
        before, gathered, after = seen
        self._step, self._t, self._h = step, t, h
        self._states, self._every = state_slots(step, every=every), every
        self._parameters = {p.name: p for p in step.component.parameters}
        self._u = _flat(gathered, step.inputs)
        self._seen = _places(step.outputs, self._states)
        self._x, self._after = self._where_it_is(before, after)
        self._late = np.zeros(self._x.size, bool)  # states that the second step shows

    def _where_it_is(self, before: Matrix, after: Matrix) -> tuple[Matrix, Matrix]:
        """The states of the run, and the outputs after its step.

        The start values of a sampled component are its outputs before the step, or those of the
        step; the ones with which the step is that of the run.
        """
        candidates = [before, after] if self._step.kind == "sampled" else [before]
        for signals in candidates:
            x = _flat(signals, self._states)
            y, _ = self._outputs(x, self._u)
            if _same(y, _flat(after, self._step.outputs)):
                return x, y
        raise RunError(
            "started with its values at this time it does not compute what it did in the run; "
            "expected a component whose states are all outputs or locals with start values"
        )

    def _outputs(self, x: Matrix, *inputs: Matrix, late: int = 0) -> list[Matrix]:
        """Outputs after a step from `x` with each of `inputs`, and after one more with the last.

        `late`: steps by which it begins after the time of the others.
        """
        step, found = self._step, []
        begin_at(step.component, self._t + late * self._h)
        step.component.initialize(self._values(x))
        step.component.initial(_shaped(inputs[0], step.inputs))
        if self._every and (fmu := fmu_of(step.component)) is not None:
            fmu.exit_initialization()
            overwrite(fmu, _shaped(x, self._states))
        for k, u in enumerate((*inputs, inputs[-1]), late):
            y = step.component.step(self._t + k * self._h, self._h, _shaped(u, step.inputs))
            values = [np.array(y[s.port], float).reshape(-1) for s in step.outputs]
            found.append(np.concatenate([np.zeros(0), *values]))
        return found

    def _values(self, x: Matrix) -> Mapping[str, Matrix]:
        values = {
            k: np.array(v, float).reshape(self._parameters[k].shape)
            for k, v in self._step.values.items()
        }
        settable = {p.name for p in self._step.component.parameters}
        given = _shaped(x, self._states)
        return values | {name: value for name, value in given.items() if name in settable}

    def derivatives(self, size: float, fed: NDArray[np.bool_] | None = None) -> StepDerivatives:
        """Differences with `size` and half of it, extrapolated; where `fed` is given, one each."""
        n = self._x.size
        nominal = np.concatenate([self._x, self._u])
        change = size * np.maximum(1.0, np.abs(nominal))
        columns = np.arange(nominal.size)
        if fed is not None:
            columns = np.concatenate([columns[:n], n + np.flatnonzero(_fed(fed, self._step))])
        parts = (1.0, 0.5) if fed is None else (1.0,)
        middle = np.array(self._outputs(self._x, self._u))
        # parts, signs, steps, outputs, columns
        ends = np.zeros((len(parts), 2, 2, self._after.size, nominal.size))
        ends += middle[:, :, None]
        late = np.ones(n, bool)
        for j in columns:
            for i, part in enumerate(parts):
                for k, sign in enumerate((1.0, -1.0)):
                    z = nominal.copy()
                    z[j] += sign * part * change[j]
                    ends[i, k, :, :, j] = self._outputs(z[:n], z[n:])
                    late &= ends[i, k, 0, self._seen, j] == z[:n]
        self._late = late
        states = np.where(late[:, None], ends[:, :, 1, self._seen], ends[:, :, 0, self._seen])
        seen = np.concatenate([states, ends[:, :, 0]], axis=2)
        slopes = (seen[:, 0] - seen[:, 1]) / (2.0 * np.array(parts)[:, None, None] * change)
        if fed is None:
            found, rough = (4.0 * slopes[1] - slopes[0]) / 3.0, np.abs(slopes[1] - slopes[0])
        else:
            still = np.concatenate(
                [np.where(late, middle[1][self._seen], middle[0][self._seen]), middle[0]]
            )[:, None]
            found, rough = slopes[0], np.abs(seen[0, 0] + seen[0, 1] - 2.0 * still) / (2.0 * change)
        top = float(np.abs(found).max(initial=0.0)) or 1.0
        A, B, C, D = found[:n, :n], found[:n, n:], found[n:, :n], found[n:, n:]
        error = float(rough.max(initial=0.0)) / top
        return StepDerivatives(self._step.name, self._states, self._x, A, B, C, D, error)

    def check_goes_on(self, size: float) -> None:
        """Raise RunError if the states do not say how it goes on after a step.

        Everything is changed a little, one step is made, and the component goes on; then it is
        started in the state in which the step ended.
        """
        sign = np.where(np.arange(self._u.size) % 2, -0.7, 1.0)
        changed = self._u + size * sign * np.maximum(1.0, np.abs(self._u))
        y, *on = self._outputs(self._x, changed, *[self._u] * AHEAD)
        x = np.where(self._late, on[0][self._seen], y[self._seen])
        again = self._outputs(x, *[self._u] * AHEAD, late=1)
        if not all(_same(a, b) for a, b in zip(on[:AHEAD], again, strict=False)):
            raise RunError(
                "after a step it does not go on as one that is started with the values of its "
                "outputs; expected a component whose states are all outputs or locals with start "
                "values"
            )

    def check_stays(
        self, found: StepDerivatives, size: float, fed: NDArray[np.bool_] | None
    ) -> None:
        """Raise RunError if a memory of all outputs and locals moves from step to step.

        The derivatives of the next step are then others, as those of a ring of samples are.
        """
        if not self._every:
            return
        after = copy(self)
        after._t, after._x = self._t + self._h, self._outputs(self._x, self._u)[0][self._seen]
        again = after.derivatives(size, fed)
        for name in "ABCD":
            one, other = getattr(found, name), getattr(again, name)
            if np.abs(one - other).max(initial=0.0) > MOVES * np.abs(one).max(initial=1.0):
                raise RunError(
                    "its derivatives change from step to step, as those of a ring of samples do, "
                    "or of a law with an edge; expected a component whose memory stays where it "
                    "is, and a smooth law"
                )


def _same(a: Matrix, b: Matrix) -> bool:
    return bool((np.abs(a - b) <= AGAIN * np.maximum(1.0, np.abs(b))).all())


def _flat(signals: Matrix, slots: Sequence[Slot]) -> Matrix:
    return np.concatenate([np.zeros(0), *(signals[s.start : s.start + s.size] for s in slots)])


def _fed(fed: NDArray[np.bool_], step: Step) -> NDArray[np.bool_]:
    parts = [fed[s.start : s.start + s.size] for s in step.inputs]
    return np.concatenate([np.zeros(0, bool), *parts])


def _shaped(values: Matrix, slots: Sequence[Slot]) -> dict[str, Matrix]:
    found, first = {}, 0
    for slot in slots:
        found[slot.port] = values[first : first + slot.size].reshape(slot.shape)
        first += slot.size
    return found


def _places(slots: Sequence[Slot], some: Sequence[Slot]) -> NDArray[np.intp]:
    """Places of `some` in the flattened values of `slots`."""
    first, places = 0, [np.zeros(0, np.intp)]
    chosen = {s.name for s in some}
    for slot in slots:
        if slot.name in chosen:
            places.append(np.arange(first, first + slot.size))
        first += slot.size
    return np.concatenate(places)
