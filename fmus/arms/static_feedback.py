"""Shared part of adaptive laws with static feedback in NumPy: reference of ``static_feedback.h``.

The reference velocity z is a function of the measured and received signals, or a state that they
drive::

    tau        = Y(q, dq, z, dz) theta_hat + feedback
    dtheta_hat = -Gamma Y' s,   s = dq - z

with the regressor Y of ``dynamics`` for the planar arm; for an arm with a table with that of
``serial_arm``, which adds the torque of what is known. Outputs are as of t_k; theta_hat advances by
the explicit Euler method, and is not updated while a torque is at its limit (anti-windup).

Source: the passivity-based adaptive controller of J.-J. E. Slotine, W. Li, "On the adaptive control
of robot manipulators", Int. J. Robotics Research 6(3), 1987; each law gives the source of its z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

from cosim.base.copies import replace
from cosim.base.errors import FmuError
from fmus.arms import chain, serial_arm
from fmus.arms.dynamics import regressor
from fmus.arms.joints import (
    GAMMA,
    NETWORK,
    PLANAR,
    THETA_HAT,
    THETA_HAT_NEXT,
    Joints,
    controller,
)
from fmus.build.reference import Law, Values
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

_SOURCES: tuple[str, ...] = ("trig.c", "regressor.h", "limit.h")


class Feedback(NamedTuple):
    """Results of a controller at one instant, per joint: `s`, `z` rad/s, `dz` rad/s², N.m."""

    s: Array
    z: Array
    dz: Array
    feedback: Array


def disagreement(own: Array, received: Array) -> Array:
    """The sum over the neighbours of `own` - received, (m,); `received` (m,) or (neighbours, m)."""
    return np.asarray(np.sum(own - np.atleast_2d(received), axis=0))


def mean_disagreement(own: Array, received: Array) -> Array:
    """The mean over the neighbours of `own` - received, (m,), of the same arguments."""
    return disagreement(own, received) / len(np.atleast_2d(received))


def _planar(x: Values, q: Array, dq: Array, z: Array, dz: Array) -> tuple[Array, Array]:
    return regressor(q, dq, z, dz), np.zeros_like(q)


def adaptive(
    name: str, feedback: Callable[..., Feedback], *, dynamic: bool = False, serial: bool = False
) -> tuple[Law, Law]:
    """Law and start of a controller by its `feedback` of x and the inputs; s is output `name`.

    `dynamic`: z is a state, which `feedback` takes from ``z_next``; it stands still with theta_hat.
    `serial`: of an arm with a table instead of the planar one.
    """
    linear = serial_arm.linear if serial else _planar

    def law(x: Values, t: float, h: float, q: Array, dq: Array, *heard: Array) -> Values:
        s, z, dz, wanted = feedback(x, q, dq, *heard)
        theta_hat = x["theta_hat_next"]
        Y, known = linear(x, q, dq, z, dz)
        wanted = Y @ theta_hat.ravel() + known + wanted
        tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
        limited = (tau != wanted).any()
        adapted = (
            theta_hat
            if limited
            else theta_hat - h * x["Gamma"] * (Y.T @ s).reshape(theta_hat.shape)
        )
        now = {"tau": tau, name: s, "theta_hat": theta_hat, "theta_hat_next": adapted}
        return now | {"z": z, "z_next": z if limited else z + h * dz} if dynamic else now

    def start(x: Values, *inputs: Array) -> Values:
        if serial:
            chain.check(chain.of_values(x), "the table")
        state = {"theta_hat_next": x["theta_hat"]}
        return state | {"z_next": x["z"]} if dynamic else state

    return law, start


@final
@dataclass(frozen=True, slots=True)
class LawSize:
    """For whom a law is declared: `neighbours`, and the planar arm, or any `arm` with a table.

    Raises FmuError for less than one neighbour.
    """

    neighbours: int = 1
    arm: Joints = PLANAR
    serial: bool = False

    def __post_init__(self) -> None:
        if self.neighbours < 1:
            raise FmuError(f"neighbours is {self.neighbours}; expected at least 1")

    def received(self, name: str, unit: str, description: str) -> Variable:
        """The input of what neighbours send: (m,) from one, (neighbours, m) from several."""
        count, joints = self.neighbours, self.arm.count
        shape = (joints,) if count == 1 else (count, joints)
        rows = "" if count == 1 else ", a row for each neighbour"
        return Variable(name, "input", shape, unit, description=description + rows)

    def controller(
        self,
        identifier: str,
        description: str,
        signals: tuple[Variable, ...],
        gains: tuple[Variable, ...],
        coupling: tuple[Variable, ...],
        documentation: str | None,
        network: Terminal = NETWORK,
    ) -> Model:
        """The controller: `signals` are what it receives and gives, `gains` stand before Gamma.

        With several neighbours the identifier says how many.
        """
        couplings = (*coupling, self.arm.tau_max)
        if self.serial:
            table = (serial_arm.gravity(), *chain.variables(self.arm))
            given = _depending(signals, tuple(v.name for v in table))
            estimate, Gamma = serial_arm.estimate(self.arm), serial_arm.adaptation(self.arm)
            variables = (*given, *estimate, *gains, Gamma, *couplings, *table)
            name, step, known = f"arm_{identifier}", 1e-3, serial_arm.SOURCES
            defines: tuple[tuple[str, int], ...] = (("SERIAL_ARM", 1),)
        else:
            variables = (*signals, THETA_HAT, THETA_HAT_NEXT, *gains, GAMMA, *couplings)
            name, step, known, defines = identifier, 5e-3, _SOURCES, ()
        sources = ("static_feedback.h", *known)
        made = controller(
            identifier, description, variables, sources, documentation, network, self.arm
        )
        several = f"{name}_n{self.neighbours}" if self.neighbours > 1 else name
        return replace(made, identifier=several, step=step, lanes=True, defines=defines)


def _depending(signals: tuple[Variable, ...], starts: tuple[str, ...]) -> tuple[Variable, ...]:
    """`signals`, of which `tau` depends on `starts` as well."""
    return tuple(
        replace(v, start_depends=(*v.start_depends, *starts)) if v.name == "tau" else v
        for v in signals
    )


def serial_model(
    declare: Callable[[LawSize, str | None], Model], documentation: str | None
) -> Callable[..., Model]:
    """The function ``model`` of a law for serial arms, of which `declare` declares any size."""

    def model(joints: int = 7, neighbours: int = 1) -> Model:
        """Declare the controller of an arm of `joints`, from 1 to 16, with `neighbours` >= 1.

        Raises FmuError for other numbers.
        """
        return declare(LawSize(neighbours, Joints(joints), serial=True), documentation)

    return model
