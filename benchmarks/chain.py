"""Dynamics of an arm of seven joints: ours, Pinocchio's and MuJoCo's, in one run.

    pip install -e '.[oracles]' cmeel-eigen
    python benchmarks/chain.py [--quick] [--json FILE]

Microseconds of processor time for one evaluation, the least of nine rounds, called from C or C++
without Python in between. All compute the same accelerations and torques of the same arm, which is
checked. Pinocchio is called from a C++ program that is compiled with ``-O3`` against the headers of
its wheel, with g++ in about two minutes (not with ``--quick``); MuJoCo is called in its library.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from benchmarks import tables
from fmus.arms import chain
from fmus.arms.chain import Table
from fmus.build import kernel, toolchain
from fmus.models import arm, arm_task, arm_teleoperation, pd

C = Path(__file__).parent / "c"
JOINTS, ROUNDS = 7, 9
#: Models of seven joints whose step is measured: name in the table, module, values of parameters.
MODELS: tuple[tuple[str, ModuleType, dict[str, float]], ...] = (
    ("plant arm", arm, {"damping": 5.0}),
    ("controller pd", pd, {}),
    ("controller arm_teleoperation, gravity adapted", arm_teleoperation, {"gravity": 2.0}),
    ("controller arm_teleoperation, gravity compensated", arm_teleoperation, {"gravity": 1.0}),
    ("controller arm_task, 3 coordinates", arm_task, {"gravity": 1.0, "k_n": 1.0, "k_l": 1.0}),
    ("controller arm_task, damped", arm_task, {"gravity": 1.0, "k_n": 1.0, "sigma_0": 9.0}),
)
PINOCCHIO_FLAGS = (
    "-O3", "-std=c++17", "-DNDEBUG", "-DBOOST_FUSION_INVOKE_MAX_ARITY=10",
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
)  # fmt: skip


def random_table() -> Table:
    """Seven revolute joints in random directions; links of some point masses."""
    rng = np.random.default_rng(7)
    rotations = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(JOINTS)]
    inertia = []
    for _ in range(JOINTS):
        m, p = rng.uniform(0.05, 0.5, 6), rng.uniform(-0.2, 0.2, (6, 3))
        arms = np.einsum("i,ij,ik->jk", m, p, p)
        tensor = np.trace(arms) * np.eye(3) - arms
        inertia.append([m.sum(), *(m @ p), *tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    return Table(
        joint_type=np.zeros(JOINTS),
        rotation=np.array([R * np.linalg.det(R) for R in rotations]),
        origin=rng.uniform(-0.4, 0.4, (JOINTS, 3)),
        inertia=np.array(inertia),
        armature=np.zeros(JOINTS),
        g=np.array([0.0, 0.0, -9.81]),
    )


def least(call: Callable[[int], object], times: int) -> float:
    """Microseconds of processor time for one of `times`, the least of some rounds."""
    found = []
    for _ in range(ROUNDS):
        start = time.process_time()
        call(times)
        found.append(time.process_time() - start)
    return 1e6 * min(found) / times


def compiled(folder: Path) -> ctypes.CDLL:
    """The loops in C."""
    output = folder / f"loops{toolchain.shared_suffix()}"
    include = Path(toolchain.__file__).parents[1] / "c"
    files = [C / "chain.c", include / "trig.c"]
    return ctypes.CDLL(str(toolchain.compile_shared(files, output, include=[include])))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def ours(loops: ctypes.CDLL, table: Table, state: np.ndarray, times: int) -> dict[str, float]:
    """Our forward and inverse dynamics; the results are those of the reference in NumPy."""
    held = [np.ascontiguousarray(a, dtype=float) for a in table.values().values()]
    arrays = (ctypes.c_void_p * 6)(*(a.ctypes.data for a in held))
    found = {}
    for name, reference in (("forward", chain.forward), ("inverse", chain.inverse)):
        q, dq, u = (row.copy() for row in state)
        out = np.zeros(JOINTS)
        function = getattr(loops, name)

        def call(n: int) -> None:
            function(JOINTS, arrays, pointer(q), pointer(dq), pointer(u), pointer(out), n)  # noqa: B023

        call(1)
        assert np.allclose(out, reference(table, *state), rtol=1e-9, atol=1e-9)
        found[name] = least(call, times)
    return found


def steps(loops: ctypes.CDLL, table: Table, times: int) -> dict[str, float]:
    """A step of the plant (four evaluations), and of each controller, by their kernels."""
    found = {}
    for name, module, given in MODELS:
        made = module.kernel(joints=JOINTS)
        declared = {p.name: p for p in made.parameters}
        values = {k: v for k, v in table.values().items() if k in declared}
        values |= {k: np.full(declared[k].shape, v) for k, v in given.items()}
        made.initialize(values)
        made.initial({p.name: np.full(p.shape, 0.1) for p in made.inputs})
        state = np.array(made.get_state())
        library = kernel.load(kernel.library(module.model(joints=JOINTS)))
        step = ctypes.cast(library.kernel_step, ctypes.c_void_p)

        def call(n: int) -> None:
            x = state.copy()  # noqa: B023
            done = loops.steps(step, pointer(x), ctypes.c_double(1e-4), n)  # noqa: B023
            assert done == 1

        found[name] = least(call, times // 10)
    return found


def body(theta: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and tensor about it."""
    m, c = theta[0], theta[1:4] / theta[0]
    return m, c, chain.tensor(theta) - m * (c @ c * np.eye(3) - np.outer(c, c))


def pinocchio(table: Table, state: np.ndarray, times: int, folder: Path) -> dict[str, float]:
    """Pinocchio's ABA in both conventions, and RNEA. Raises RuntimeError without it."""
    try:
        import pinocchio as pin
    except ImportError as error:
        raise RuntimeError(f"Pinocchio: {error}") from None
    prefix = Path(pin.__file__).parents[4]
    program = folder / "pinocchio"
    include = [f"-I{prefix / 'include'}", f"-I{prefix / 'include' / 'eigen3'}"]
    link = [f"-L{prefix / 'lib'}", "-lpinocchio_default", f"-Wl,-rpath,{prefix / 'lib'}"]
    command = ["g++", *PINOCCHIO_FLAGS, *include, str(C / "pinocchio.cpp"), "-o", str(program)]
    done = subprocess.run([*command, *link], capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line]
        raise RuntimeError(f"Pinocchio: {lines[0] if lines else done.stderr[-200:]}")
    given: list[float] = [times, JOINTS]
    for R, r, theta in zip(table.rotation, table.origin, table.inertia, strict=True):
        m, c, I = body(theta)  # noqa: E741
        given += [*R.ravel(), *r, m, *c, *I[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    text = " ".join(repr(float(x)) for x in [*given, *state.ravel()])
    said = subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout
    found = {}
    for line in said.splitlines():
        name, seconds, *result = line.split()
        expected = (chain.inverse if name == "rnea" else chain.forward)(table, *state)
        assert np.allclose(np.array(result, dtype=float), expected, rtol=1e-8, atol=1e-8), name
        found[name] = 1e6 * float(seconds)
    return found


def mujoco(loops: ctypes.CDLL, table: Table, state: np.ndarray, times: int) -> dict[str, float]:
    """MuJoCo's forward and inverse dynamics and a step. Raises RuntimeError without it."""
    try:
        import mujoco as mj
    except ImportError as error:
        raise RuntimeError(f"MuJoCo: {error}") from None
    model = mj.MjModel.from_xml_string(mjcf(table))
    data = mj.MjData(model)
    library = ctypes.CDLL(str(next(Path(mj.__file__).parent.glob("libmujoco.so*"))))
    addresses = ctypes.c_void_p(model._address), ctypes.c_void_p(data._address)
    found = {}
    for name in ("mj_forward", "mj_inverse", "mj_step"):
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = state[:2]
        data.qacc[:] = data.qfrc_applied[:] = state[2]
        function = ctypes.cast(getattr(library, name), ctypes.c_void_p)

        def call(n: int) -> None:
            loops.mujoco(function, *addresses, n)  # noqa: B023

        call(1)
        if name == "mj_forward":
            expected = chain.forward(table, *state)
            assert np.allclose(data.qacc, expected, rtol=1e-8, atol=1e-8)
        found[name] = least(call, times // 10)
    return found


def mjcf(table: Table) -> str:
    """The arm for MuJoCo; without contacts, limits and friction."""
    inside = ""
    for R, r, theta in reversed(
        list(zip(table.rotation, table.origin, table.inertia, strict=True))
    ):
        m, c, I = body(theta)  # noqa: E741
        entries = I[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        axes = [*R[:, 0], *R[:, 1]]
        inside = (
            f'<body pos="{spaced(r)}" xyaxes="{spaced(axes)}"><joint axis="0 0 1"/>'
            f'<inertial pos="{spaced(c)}" mass="{float(m)!r}" fullinertia="{spaced(entries)}"/>'
            f"{inside}</body>"
        )
    option = '<option timestep="1e-5"><flag constraint="disable"/></option>'
    return f"<mujoco>{option}<worldbody>{inside}</worldbody></mujoco>"


def spaced(values: Any) -> str:
    return " ".join(repr(float(x)) for x in values)


def measure(times: int, *, compile_pinocchio: bool) -> dict[str, Any]:
    """Every number, in microseconds."""
    table, rng = random_table(), np.random.default_rng(1)
    state = rng.uniform(-1, 1, (3, JOINTS))
    found: dict[str, Any] = {"machine": tables.machine(), "absent": []}
    with TemporaryDirectory() as name:
        folder = Path(name)
        loops = compiled(folder)
        found["ours"] = ours(loops, table, state, times)
        found["steps"] = steps(loops, table, times)
        others: dict[str, Callable[[], dict[str, float]]] = {
            "mujoco": lambda: mujoco(loops, table, state, times)
        }
        if compile_pinocchio:
            others["pinocchio"] = lambda: pinocchio(table, state, times, folder)
        for other, run in others.items():
            try:
                found[other] = run()
            except RuntimeError as error:
                found["absent"].append(str(error))
        found["ours again"] = ours(loops, table, state, times)
    return found


def rows(found: dict[str, Any]) -> list[list[str]]:
    """The table."""
    forward = min(found["ours"]["forward"], found["ours again"]["forward"])
    inverse = min(found["ours"]["inverse"], found["ours again"]["inverse"])
    listed = [
        ["ours, forward dynamics (chain_forward)", forward, forward],
        ["ours, inverse dynamics (chain_inverse)", inverse, inverse],
    ]
    listed += [[f"ours, a step: {name}", us, None] for name, us in found["steps"].items()]
    if peer := found.get("pinocchio"):
        listed += [
            ["Pinocchio, aba, Convention::LOCAL", peer["local"], forward],
            ["Pinocchio, aba, Convention::WORLD", peer["world"], forward],
            ["Pinocchio, rnea", peer["rnea"], inverse],
        ]
    if peer := found.get("mujoco"):
        listed += [
            ["MuJoCo, mj_forward", peer["mj_forward"], forward],
            ["MuJoCo, mj_inverse", peer["mj_inverse"], inverse],
            ["MuJoCo, mj_step (Euler)", peer["mj_step"], None],
        ]
    return [[str(a), f"{b:.2f}", f"{c / b:.2f}" if c else ""] for a, b, c in listed]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="only test that everything runs")
    parser.add_argument("--json", type=Path, help="write every number to this file")
    options = parser.parse_args()
    times = 1000 if options.quick else 100_000
    found = measure(times, compile_pinocchio=not options.quick)
    print(tables.grid(["seven joints", "µs", "ours / theirs"], rows(found)))
    for text in found["absent"]:
        print(f"\nnot measured: {text}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
