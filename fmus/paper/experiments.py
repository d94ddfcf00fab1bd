"""The experiments of the paper as scenario documents, equivalent to TOML files.

Numbers are those of the paper's Sec. VII. Values that the paper leaves open are defined here: the
arm is the preset SL91, horizontal; every robot starts at rest with z = 0 and theta_hat = 0;
controllers are sampled every 5 ms, arms integrated at 1 ms or finer, with the operator's grip and
the wall inside the arm; delays are T = 0.3 s + U[0, 0.9] s, redrawn every 30 ms, independently for
each link.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, pi
from typing import Any, TypeAlias

from cosim.graphs.graph import PRESETS, union

Document: TypeAlias = dict[str, Any]
Table: TypeAlias = Mapping[str, Any]

#: Sampling period of the controllers, s (Sec. VII-A).
PERIOD = 5e-3
#: Lumped parameters of the arm SL91, kg.m2: what theta_hat estimates.
THETA = (3.34, 1.20, 0.97)
#: Gravity of the same arm if it stood upright, N.m: (m1 lc1 + m2 l1) g, m2 lc2 g.
THETA_G = (2.5 * 9.81, 1.2 * 9.81)
#: Position at which the operator wants the robots, rad.
Q_H = (3.5, 3.0)
#: The operator: tau_h = -5 dq - 10 (q - q_h).
GRIP: Table = {"k_p": 10.0, "k_d": 5.0, "q_h": list(Q_H)}
#: Initial joint positions of the six robots, rad (Sec. VII-B).
STARTS = (
    (-pi / 3, -pi / 2),
    (-2 * pi / 3, pi / 3),
    (5 * pi / 6, -pi / 3),
    (pi / 6, pi / 2),
    (pi / 2, pi / 6),
    (-pi / 6, -pi / 3),
)
#: T = 0.3 s + U[0, 0.9] s, redrawn every 30 ms (Sec. VII-B).
DELAY: Table = {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}
#: Time for which each graph lasts, s (Sec. VII-B).
DWELL = 0.15


def arm(
    tau: str, q: Sequence[float] = (0.0, 0.0), period: float = PERIOD, **values: Any
) -> Document:
    """A planar arm that starts at `q` (rad) and takes its torque from `tau`.

    `values`: further parameters, start values, and constant inputs (``tau_ext``).
    """
    return {
        "model": "fmus.models.planar2r",
        "period": period,
        "start": {"q": list(q), "substeps": max(1, ceil(period / 1e-3 - 1e-9)), **values},
        "inputs": {"tau": tau},
    }


def document(
    title: str, stop: float, components: Table, record: Sequence[str], **rest: Any
) -> Document:
    """A whole document; `rest`: ``step`` (default 5 ms), ``every``, ``seed``, ``links``, ..."""
    run = {"step": rest.pop("step", PERIOD), "stop": stop, "seed": rest.pop("seed", 0)}
    recorded = {"signals": sorted(record), "every": rest.pop("every", 1)}
    return {
        "title": title,
        "run": {**run, "record": recorded},
        "components": dict(components),
        **{key: value for key, value in rest.items() if value},
    }


# ---- Sec. IV, Sec. VII-A: one arm ---------------------------------------------------------------


def single(
    stop: float = 20.0,
    *,
    period: float = PERIOD,
    grip: Table = GRIP,
    arm_values: Table | None = None,
    every: int = 1,
    **gains: Any,
) -> Document:
    """One arm under eqs (29)-(32), held by the operator; Sec. VII-A with `lambda_M` = 6.

    `stop` and `period` are in s. `gains` change the controller's K, Gamma, alpha, lambda_M,
    theta_hat, ... from Sec. VII-A's; `grip` = {} lets go of the arm; `arm_values` are further
    values of the arm; every `every`-th row is recorded.
    """
    values = {"K": 16.0, "Gamma": 8.0, "alpha": 2.0, "lambda_M": 6.0, **gains}
    components = {
        "robot": arm("control.tau", period=period, **{**grip, **(arm_values or {})}),
        "control": controller("robot", 0, period, values),
    }
    record = ("robot.q", "robot.dq", "robot.tau_h", "control.tau", "control.s", "control.z",
              "control.theta_hat")  # fmt: skip
    return document(
        "Teaching operation of a single robot", stop, components, record, step=period, every=every
    )


def damped(
    stop: float,
    *,
    period: float = 1e-3,
    grip: Table = GRIP,
    known: float = 1.0,
    **arm_values: Any,
) -> Document:
    """One upright arm under eq. (24), 5 N.m.s/rad and gravity compensated; Theorem 1.

    `known`: share of the arm's gravity that the controller knows.
    """
    components = {
        "robot": arm("control.tau", period=period, theta_g=list(THETA_G), **{**grip, **arm_values}),
        "control": {
            "model": "fmus.models.damping",
            "period": period,
            "start": {"d": 5.0, "theta_g": [known * x for x in THETA_G]},
            "inputs": {"q": "robot.q", "dq": "robot.dq"},
        },
    }
    record = ("robot.q", "robot.dq", "robot.tau_h")
    return document("Damping and gravity", stop, components, record, step=period, every=5)


def mass(stop: float, *, b: float, force: float | None = None) -> Document:
    """A point mass of 1 kg, friction `b` (N.s/m), f = 1/(t + 1) or `force` (N); Sec. III."""
    step = 0.01
    point: Document = {"model": "fmus.models.pointmass", "period": step, "start": {"b": b}}
    components = {"mass": point}
    if force is None:
        components["push"] = {"model": "fmus.models.decaying_push", "period": step}
        point["inputs"] = {"f": "push.f"}
    else:
        point["start"]["f"] = force
    return document(
        "Point mass", stop, components, ("mass.x", "mass.dx", "mass.f"), step=step, every=10
    )


# ---- Sec. VI, Sec. VII-C: the teleoperator ------------------------------------------------------


def teleoperator(
    stop: float = 60.0,
    *,
    seed: int = 0,
    period: float = PERIOD,
    link: Table | None = None,
    back: Table | None = None,
    grip: Table = GRIP,
    master: Table | None = None,
    slave: Table | None = None,
    **gains: Any,
) -> Document:
    """Master and slave under eqs (76)-(81), the first two robots of Sec. VII-B; Sec. VII-C.

    `link`: delay and semantics from master to slave, `back` the other way (default the same);
    {} is no delay: xi is then taken next to the robot, so that there is no loop. `master` and
    `slave` are further values of the arms (a wall, a push), `gains` of both controllers. `stop` and
    `period` are in s, gains in the units of :mod:`fmus.models.teleoperation`.
    """
    forth = {"delay": dict(DELAY)} if link is None else link
    back = forth if back is None else back
    values = {"K": 16.0, "Gamma": 1.0, "alpha": 0.5, "lambda": 2.0, "lambda_M": 10.0, **gains}
    components: Document = {}
    links: list[Document] = []
    sides = (("master", STARTS[0], {**grip, **(master or {})}), ("slave", STARTS[1], slave or {}))
    for (name, q, held), other, way in zip(sides, ("slave", "master"), (back, forth), strict=True):
        components[name] = arm(f"{name}_control.tau", **{"q": q, "period": period, **held})
        components[f"{name}_control"] = controller(name, 1, period, values)
        if way:
            links.append({"from": f"{other}_control.xi", "to": f"{name}_control.xi_in[0]", **way})
        else:
            components[f"{other}_xi"] = signal(other, values["alpha"], period)
            components[f"{name}_control"]["inputs"]["xi_in[0]"] = f"{other}_xi.xi"
    record = [f"{side}.{port}" for side in ("master", "slave") for port in ("q", "dq")]
    record += ["master.tau_h", "slave.tau_e", "master_control.tau", "slave_control.tau"]
    return document(
        "Bilateral teleoperation", stop, components, record, step=period, seed=seed, links=links,
        every=2,
    )  # fmt: skip


# ---- Sec. V, Sec. VII-B: six arms ---------------------------------------------------------------


def network(
    stop: float = 120.0,
    *,
    graphs: str = "ring",
    schedule: Table | None = None,
    operator: int = 3,
    seed: int = 0,
    period: float = PERIOD,
    link: Table | None = None,
    grip: Table = GRIP,
    push: Sequence[float] = (0.0, 0.0),
    torques: bool = False,
    substeps: int | None = None,
    **gains: Any,
) -> Document:
    """Six arms under eqs (42)-(45), or (61) over a `link` with delay; Sec. VII-B.

    `graphs`: a preset of :mod:`cosim.graphs.graph`, switched at random every 150 ms, or as
    `schedule` says (``{"schedule": ...}``, {} is the first graph for ever); the robot `operator`
    is held by the operator and pushed with `push` (N.m); `torques`: record these, and every row
    instead of every fourth. `substeps` of the arms' integration in a period (default: of 1 ms).
    `gains` of all controllers.
    """
    steps = {} if substeps is None else {"substeps": substeps}
    values = {"K": 16.0, "Gamma": 8.0, "alpha": 1.6, "lambda": 1.0, "lambda_M": 10.0, **gains}
    heard = neighbours(graphs)
    components: Document = {}
    links: list[Document] = []
    for i, q in enumerate(STARTS, 1):
        held = {**grip, "tau_ext": list(push)} if i == operator else {}
        components[f"robot{i}"] = arm(f"control{i}.tau", q, period, **held, **steps)
        components[f"control{i}"] = controller(f"robot{i}", len(heard[i]), period, values)
        if not link and any(i in senders for senders in heard.values()):
            components[f"xi{i}"] = signal(f"robot{i}", values["alpha"], period)
        for k, j in enumerate(heard[i]):
            to = f"xi_in[{k}]"
            if link:
                links.append({"from": f"control{j}.xi", "to": f"control{i}.{to}", **link})
            else:
                components[f"control{i}"]["inputs"][to] = f"xi{j}.xi"
    weights = {f"control{i}.w[{k}]": [i, j] for i in heard for k, j in enumerate(heard[i])}
    switching = {"dwell": DWELL} if schedule is None else schedule
    topology = {"graphs": graphs, "weights": weights, **switching}
    record = [f"robot{i}.q" for i in heard] + [f"robot{operator}.tau_h"]
    record += [f"control{i}.tau" for i in heard if torques]
    return document(
        "Six networked robots", stop, components, record, step=period, seed=seed, links=links,
        topology=topology, every=1 if torques else 4,
    )  # fmt: skip


def neighbours(graphs: str) -> dict[int, tuple[int, ...]]:
    """The neighbours from which each robot of a preset receives, in any of its graphs."""
    edges = union(PRESETS[graphs]).edges
    return {i: tuple(j for k, j in edges if k == i) for i in range(1, len(STARTS) + 1)}


# ---- parts --------------------------------------------------------------------------------------


def controller(robot: str, heard: int, period: float, values: Table) -> Document:
    """The adaptive controller of `robot`, sampled every `period` s; `values` are its gains.

    `heard` is the number of its neighbours. With ``gravity`` among the gains, the controller
    handles gravity: 1 compensates it, 2 adapts to it.
    """
    alone = {key: value for key, value in values.items() if key != "lambda"}
    sizes = {"neighbours": heard} if heard else {}
    sizes |= {"gravity": 1} if "gravity" in values else {}
    return {
        "model": "fmus.models.teleoperation" if heard else "fmus.models.adaptive",
        "sizes": sizes,
        "period": period,
        "start": dict(values) if heard else alone,
        "inputs": {"q": f"{robot}.q", "dq": f"{robot}.dq"},
    }


def signal(robot: str, alpha: float, period: float) -> Document:
    """Xi = dq + alpha q of a robot, computed next to it every `period` s, eq. (47).

    `alpha` is in 1/s.
    """
    return {
        "model": "fmus.models.xi",
        "period": period,
        "parameters": {"alpha": alpha},
        "inputs": {"q": f"{robot}.q", "dq": f"{robot}.dq"},
    }
