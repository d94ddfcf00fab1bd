"""A scene file, read: MuJoCo's model, and what a run records about it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import MujocoError
from cosim.mujoco.library import package, warnings
from cosim.mujoco.urdf import Mimic, check_words, mimics, urdf_remarks, urdf_root

#: Kinds of objects that have names, by MuJoCo's word.
JOINT, ACTUATOR, SENSOR, SITE, BODY, KEY = "JOINT", "ACTUATOR", "SENSOR", "SITE", "BODY", "KEY"


@dataclass(frozen=True, slots=True)
class Scene:
    """A compiled model: `model` is MuJoCo's ``MjModel``, from the file `path`.

    `said`: remarks on the file; `mimics`: joints that follow others; `is_urdf`: not an MJCF file.
    """

    path: Path
    model: Any
    said: tuple[str, ...] = ()
    mimics: tuple[Mimic, ...] = ()
    is_urdf: bool = False

    @property
    def time_step(self) -> float:
        """The time step of the file, s."""
        return float(self.model.opt.timestep)

    @property
    def integrator(self) -> str:
        """The integrator of the file, as the file names it."""
        name = str(package().mjtIntegrator(self.model.opt.integrator).name)
        return name.removeprefix("mjINT_")

    def names(self, kind: str) -> list[str]:
        """The names of all objects of a kind, "" for one without a name."""
        mujoco = package()
        object_type = getattr(mujoco.mjtObj, f"mjOBJ_{kind}")
        counts = {JOINT: "njnt", ACTUATOR: "nu", SENSOR: "nsensor", SITE: "nsite", BODY: "nbody"}
        n = getattr(self.model, counts.get(kind, "nkey"))
        return [mujoco.mj_id2name(self.model, object_type, i) or "" for i in range(n)]

    def data(self) -> Any:
        """New ``MjData`` of the model. Raises MujocoError if MuJoCo cannot make it."""
        mujoco = package()
        try:
            return mujoco.MjData(self.model)
        except (ValueError, mujoco.FatalError) as error:
            raise MujocoError(f"{self.path}: {' '.join(str(error).split())}") from None

    def compiled(self) -> bytes:
        """The compiled model: what was read from the file, its includes and its meshes."""
        mujoco = package()
        buffer = np.zeros(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return buffer.tobytes()

    def facts(self) -> Iterator[tuple[str, str]]:
        """The facts that a run records: file, sums, versions and the settings that determine a
        step.
        """
        yield "file", str(self.path)
        yield "sha256", hashlib.sha256(self.path.read_bytes()).hexdigest()
        yield "compiled_sha256", hashlib.sha256(self.compiled()).hexdigest()
        yield "simulator", f"MuJoCo {package().mj_versionString()}"
        yield "step", f"{self.time_step:g} s"
        yield "integrator", self.integrator

    def counts(self) -> Iterator[tuple[str, str]]:
        """The numbers of the scene's parts."""
        model = self.model
        yield "gravity", " ".join(f"{g:g}" for g in model.opt.gravity) + " m/s2"
        yield "joints", f"{model.njnt} ({model.nv} degrees of freedom)"
        yield "actuators", str(model.nu) if model.nu else "0: tau acts on the joints themselves"
        yield "sensors", str(model.nsensor)
        yield "keyframes", ", ".join(filter(None, self.names(KEY))) or "none"
        joints = self.names(JOINT)
        for x in self.mimics:
            law = f"{joints[x.joint]} = {x.factor:g} {joints[x.other]}"
            yield "mimic", law + (f" {x.offset:+g}" if x.offset else "")


def read_scene(path: Path) -> Scene:
    """Read an MJCF or URDF file. Raises MujocoError for what MuJoCo does not accept."""
    mujoco = package()
    if not path.is_file():
        raise MujocoError(f"{path} does not exist; expected an MJCF or URDF file")
    try:
        with warnings() as heard:
            model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise MujocoError(f"{path}: {' '.join(str(error).split())}") from None
    said = tuple(f"MuJoCo: {' '.join(text.split())}" for text in heard)
    root = urdf_root(path)
    if root is None:
        return Scene(path, model, said)
    check_words(path, root)
    following = mimics(path, root, model)
    return Scene(path, model, (*said, *urdf_remarks(root, model)), following, is_urdf=True)
