"""A scene of MuJoCo as a continuous Component, stepped by the engine without Python."""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.base.errors import MujocoError, RunError, ScenarioError
from cosim.base.names import unknown
from cosim.mujoco import MujocoOptions
from cosim.mujoco.joints import joint_groups
from cosim.mujoco.library import functions, package
from cosim.mujoco.ports import input_ports, output_ports, refuse_duplicates, start_ports
from cosim.mujoco.remarks import scene_remarks, start_remarks
from cosim.mujoco.scene import JOINT, KEY, Scene, read_scene
from cosim.native.structs import MujocoStruct

#: Difference of a joint from the one that it mimics that is rounding, rad or m.
_APART = 1e-6
#: Relative difference between a period and whole time steps that is rounding.
ROUNDING = 1e-9


@final
class MujocoComponent:
    """One MuJoCo scene: joints, objects, contacts, actuators and sensors.

    Inputs are held over a step; outputs are those at its end. `path`: an MJCF or URDF file; `data`:
    MuJoCo's ``MjData``, for viewers. Raises MujocoError if MuJoCo is missing or does not accept the
    file, and for options that do not fit.
    """

    def __init__(self, path: Path, options: MujocoOptions | None = None) -> None:
        options = options or MujocoOptions()
        self.scene: Scene = read_scene(path)
        self._functions, self._mujoco = functions(), package()
        self.data: Any = self.scene.data()
        self._key = self._keyframe(options.keyframe)
        self._reset()
        groups = joint_groups(self.scene, options)
        self._groups = groups
        self._inputs = input_ports(self.scene, groups, self.data)
        self._outputs = output_ports(self.scene, groups, self.data, options)
        self._starts = start_ports(self.scene, groups, self.data)
        self.kind: Kind = "continuous"
        self.inputs: tuple[Port, ...] = tuple(x.port for x in self._inputs)
        self.outputs: tuple[Port, ...] = tuple(x.port for x in self._outputs)
        self.parameters: tuple[Parameter, ...] = tuple(x.parameter for x in self._starts)
        for ports in (self.inputs, self.outputs):
            refuse_duplicates(self.scene, [port.name for port in ports])
        self._u, self._y = np.zeros(_size(self.inputs)), np.zeros(_size(self.outputs))
        self._struct = self._bound()

    def _keyframe(self, name: str) -> int:
        names = self.scene.names(KEY)
        if name and name not in names:
            raise MujocoError(
                f"{self.scene.path}: {unknown(name, filter(None, names), 'keyframe')}"
            )
        return names.index(name) if name else -1

    def _bound(self) -> MujocoStruct:
        model, data = self.scene.model, self.data
        targets = [place for x in self._inputs for place in x.addresses]
        self._arrays: list[NDArray[Any]] = [  # what C points to
            np.array(sorted(set(targets)), np.uintp),
            np.array(targets, np.uintp),
            np.array([gain for x in self._inputs for gain in x.gains], np.float64),
            np.array([place for x in self._outputs for place in x.addresses], np.uintp),
            np.array([x.scale for x in self._outputs for _ in x.addresses], np.float64),
        ]
        derived = any(x.derived for x in self._outputs)
        return MujocoStruct(
            model._address, data._address,
            self._functions.advance, self._functions.evaluate if derived else None,
            *(array.ctypes.data for array in self._arrays),
            len(self._arrays[0]), len(self._u), len(self._y), 1,
        )  # fmt: skip

    # ---- what it is --------------------------------------------------------------------------

    @property
    def model_name(self) -> str:
        """The file and the version of MuJoCo."""
        return f"{self.scene.path.name}, MuJoCo {self._mujoco.mj_versionString()}"

    def facts(self) -> Mapping[str, str]:
        """Metadata for a run: file, sums, version, time step, integrator."""
        return dict(self.scene.facts())

    def remarks(self, values: Mapping[str, tuple[float, ...]]) -> tuple[str, ...]:
        """Sentences for ``cosim check``: what the file says and the scene does not do.

        `values`: start values of the scenario, flattened, in the unit of the parameter.
        """
        self._reset()
        return (
            *scene_remarks(self.scene),
            *start_remarks(self.scene, self._groups, values, self.data),
        )

    def check_period(self, period: float, place: str) -> None:
        """Raise ScenarioError at `place` if `period` (s) is not a multiple of the time step."""
        self._substeps(period, place)

    def _substeps(self, period: float, place: str = "") -> int:
        step = self.scene.time_step
        n = round(period / step)
        if n < 1 or abs(n * step - period) > ROUNDING * period:
            option = f'<option timestep="{period:g}"/>'
            cure = f"<mujoco>{option}</mujoco> in <robot>" if self.scene.is_urdf else option
            raise ScenarioError(
                f"{self.scene.path.name} has a time step of {step:g} s (option timestep), found a "
                f"period of {period:g} s; expected a multiple of the time step: {cure} in the file "
                "(without it 2 ms), or another period of the component",
                place,
            )
        return n

    # ---- start -------------------------------------------------------------------------------

    def initialize(self, values: Values) -> None:
        """Go to the keyframe, or the scene's initial state, with `values` in place of its own."""
        self._reset()
        self._struct.failed = 0
        for start in self._starts:
            if start.parameter.name in values:
                array = getattr(self.data, start.field)
                array[list(start.places)] = values[start.parameter.name]
        self._follow(values)

    def _follow(self, values: Values) -> None:
        """Put joints that mimic others where these are. Raises ScenarioError for another start."""
        model, names = self.scene.model, self.scene.names(JOINT)
        given = {
            (start.field, place)
            for start in self._starts
            if start.parameter.name in values
            for place in start.places
        }
        for x in self.scene.mimics:
            for field, at, offset in (
                ("qpos", model.jnt_qposadr, x.offset),
                ("qvel", model.jnt_dofadr, 0.0),
            ):
                array, place = getattr(self.data, field), int(at[x.joint])
                right = offset + x.factor * float(array[int(at[x.other])])
                if (field, place) in given and abs(array[place] - right) > _APART:
                    raise ScenarioError(
                        f"the joint {names[x.joint]!r} starts with {array[place]:g}, expected"
                        f" {right:g}: it mimics {names[x.other]!r}"
                    )
                array[place] = right

    def _reset(self) -> None:
        if self._key < 0:
            self._mujoco.mj_resetData(self.scene.model, self.data)
        else:
            self._mujoco.mj_resetDataKeyframe(self.scene.model, self.data, self._key)

    def initial(self, u: Values) -> Outputs:
        """Outputs of the initial state for inputs `u`. Raises ScenarioError if MuJoCo fails."""
        self._take(u)
        if self._functions.outputs(c.addressof(self._struct), *self._addresses()):
            raise ScenarioError(self.failure())
        return self._give()

    # ---- steps -------------------------------------------------------------------------------

    def native_step(self, period: float) -> tuple[int, int]:
        """The step function of ``cosim/c/mujoco.c`` and its scene, for steps of `period` (s)."""
        self._struct.substeps = self._substeps(period)
        return self._functions.step, c.addressof(self._struct)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """One step from `t` of length `h` (s). Raises RunError if MuJoCo fails or warns."""
        function, instance = self.native_step(h)
        self._take(u)
        if _STEP(function)(instance, t, h, *self._addresses()):
            raise RunError(self.failure(), time=t)
        return self._give()

    def failure(self) -> str:
        """The message of MuJoCo in the last step that failed."""
        said = self._struct.text.decode("utf-8", "replace").strip()
        return f"MuJoCo: {' '.join(said.split())}"

    def _addresses(self) -> tuple[int, int]:
        return self._u.ctypes.data, self._y.ctypes.data

    def _take(self, u: Values) -> None:
        at = 0
        for port in self.inputs:
            default = port.default or 0.0
            self._u[at : at + port.size] = np.ravel(u.get(port.name, default))
            at += port.size

    def _give(self) -> dict[str, NDArray[np.float64]]:
        found, at = {}, 0
        for port in self.outputs:
            found[port.name] = self._y[at : at + port.size].reshape(port.shape).copy()
            at += port.size
        return found

    # ---- state -------------------------------------------------------------------------------

    def get_state(self) -> object:
        """MuJoCo's state of integration: with the inputs and the solver's warm start."""
        which = self._mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.zeros(self._mujoco.mj_stateSize(self.scene.model, which))
        self._mujoco.mj_getState(self.scene.model, self.data, state, which)
        return state

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        which = self._mujoco.mjtState.mjSTATE_INTEGRATION
        values = np.asarray(state, np.float64)
        self._mujoco.mj_setState(self.scene.model, self.data, values, which)
        self._struct.failed = 0


_STEP = c.CFUNCTYPE(c.c_int32, c.c_void_p, c.c_double, c.c_double, c.c_void_p, c.c_void_p)


def _size(ports: Sequence[Port]) -> int:
    return sum(port.size for port in ports)
