"""Show the motion of a recorded scene in MuJoCo's viewer: ``view_mujoco.py RUN_FOLDER COMPONENT``.

The viewer needs ``pip install 'mujoco-core[rendering]'`` and a display.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from cosim.base.clock import sleep, stopwatch
from cosim.mujoco import read_options
from cosim.mujoco.component import MujocoComponent
from cosim.record import Run


def component(run: Run, name: str) -> MujocoComponent:
    """The scene of a component, read from the file that the run names."""
    scenes = run.metadata.get("simulators", {})
    if name not in scenes:
        raise SystemExit(f"no scene {name!r}; the run has: {', '.join(scenes) or 'none'}")
    options = run.metadata["scenario"]["components"][name].get("options", {})
    return MujocoComponent(Path(scenes[name]["file"]), read_options(options, name))


def poses(run: Run, scene: MujocoComponent, name: str, rate: float) -> Iterator[float]:
    """Put the scene into each recorded state, `rate` (1/s) times a second; yields the times (s)."""
    recorded = set(run.names)
    states = [
        p.name for p in scene.parameters if f"{name}.{p.name}[0]" in recorded
    ]  # q, dq, and x and quat of objects: start values that are outputs, too
    columns = {state: run.array(f"{name}.{state}") for state in states}
    shown = 0
    for row, t in enumerate(run.t):
        if t >= shown / rate - 1e-9:
            scene.initialize({state: values[row] for state, values in columns.items()})
            scene.initial({})
            yield float(t)
            shown += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("component")
    parser.add_argument("--speed", type=float, default=1.0, help="1: as fast as it was")
    given = parser.parse_args()
    from mujoco import viewer

    run = Run.open(given.run)
    scene = component(run, given.component)
    with viewer.launch_passive(scene.scene.model, scene.data) as window:
        elapsed = stopwatch()
        for t in poses(run, scene, given.component, 60.0):
            sleep(t / given.speed - elapsed())
            if not window.is_running():
                return
            window.sync()


if __name__ == "__main__":
    main()
