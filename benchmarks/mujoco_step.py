"""What a step of a scene costs beside MuJoCo's own: ``python benchmarks/mujoco_step.py``.

Both are C loops without Python: the engine with one component, and ``mj_step(model, data, steps)``.
The processor time of each is measured in turns; the table gives the least of all turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import mujoco

from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build

CONFIGS = Path(__file__).parents[1] / "configs" / "mujoco"

#: By scene, what each joint starts with (rad), and its torque (N.m): a resting arm, pressed against
#: wall or table.
START = {
    "arm.xml": [0.5, 1.0],
    "wall.xml": [0.5, 1.0],
    "openarm.xml": [-0.15, 0.3, 0.0, 1.2, 0.0, 0.0, 0.0],
}
TORQUE = {"arm.xml": [1.0, 0.5], "wall.xml": [1.0, 0.5], "openarm.xml": [0.0] * 7}


def seconds(run: Callable[[], object]) -> float:
    """Processor time of one call, s."""
    start = time.process_time()
    run()
    return time.process_time() - start


def engine(scene: str, outputs: list[str], steps: int) -> Engine:
    """An initialised engine with one scene, pushed by a constant torque."""
    start = {"q": START[scene], "tau": TORQUE[scene]}
    arm = {"model": f"mujoco:{scene}", "options": {"outputs": outputs}, "start": start}
    step = 1e-3
    document = {"run": {"step": step, "stop": step * steps}, "components": {"arm": arm}}
    made = Engine(assemble(build(document, CONFIGS / "benchmark.toml")))
    made.initialize()
    return made


def bare(scene: str, steps: int) -> Callable[[], object]:
    """The same motion with MuJoCo alone."""
    model = mujoco.MjModel.from_xml_path(str(CONFIGS / scene))
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = START[scene], TORQUE[scene]
    return lambda: mujoco.mj_step(model, data, steps)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20000)
    parser.add_argument("--turns", type=int, default=5)
    given = parser.parse_args()
    n = given.steps
    print("scene        outputs     mj_step [us]  engine [us]  ratio")
    for scene in START:
        for name, outputs in (("q, dq", ["q", "dq"]), ("all", ["*"])):
            ours = [engine(scene, outputs, n) for _ in range(given.turns)]
            theirs = [bare(scene, n) for _ in range(given.turns)]
            pairs = [
                (seconds(t), seconds(lambda o=o: o.run(n)))
                for o, t in zip(ours, theirs, strict=True)
            ]
            a, b = (min(column) / n * 1e6 for column in zip(*pairs, strict=True))
            print(f"{scene:<11}  {name:<10}  {a:12.2f}  {b:11.2f}  {b / a:5.2f}")


if __name__ == "__main__":
    main()
