"""MuJoCo: the package, its C functions, and the step of ``cosim/c/mujoco.c``.

Only this module imports ``mujoco``, and only when a scene is read: the package is an extra.
"""

from __future__ import annotations

import ctypes as c
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType

from cosim.base.errors import MujocoError
from cosim.native import structs

INSTALL = "pip install 'cosim-bridge[mujoco]'"
TEXT = 1024


class SceneStruct(c.Structure):
    """``mujoco_t``."""

    _fields_ = (
        ("model", c.c_void_p),
        ("data", c.c_void_p),
        ("advance", c.c_void_p),
        ("evaluate", c.c_void_p),
        ("applied", c.c_void_p),
        ("targets", c.c_void_p),
        ("gains", c.c_void_p),
        ("sources", c.c_void_p),
        ("scales", c.c_void_p),
        ("n_applied", c.c_int64),
        ("n_inputs", c.c_int64),
        ("n_outputs", c.c_int64),
        ("substeps", c.c_int64),
        ("failed", c.c_int32),
        ("text", c.c_char * TEXT),
    )


@dataclass(frozen=True, slots=True)
class Functions:
    """Addresses of mj_step, mj_forward and our step; our function `outputs` itself."""

    advance: int
    evaluate: int
    step: int
    outputs: c._NamedFuncPointer


@lru_cache(maxsize=1)
def package() -> ModuleType:
    """The package ``mujoco``. Raises MujocoError if it is not installed or does not load."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise MujocoError(
            f"cannot import MuJoCo ({error}); expected it installed: {INSTALL}"
        ) from None


@lru_cache(maxsize=1)
def functions() -> Functions:
    """The functions that step a scene; errors of MuJoCo in a step no longer end the process.

    Raises MujocoError for a version of MuJoCo without one of them, CosimError for an old engine.
    """
    path = _library_file()
    try:
        mujoco = c.CDLL(path)
        advance, evaluate = structs.address(mujoco.mj_step), structs.address(mujoco.mj_forward)
        handlers = [c.c_void_p.in_dll(mujoco, f"mju_user_{word}") for word in ("error", "warning")]
    except (OSError, AttributeError, ValueError) as error:
        raise MujocoError(f"{path}: {error}; expected MuJoCo 4: {INSTALL}") from None
    engine = structs.library()
    engine.mujoco_size.restype = c.c_size_t
    if engine.mujoco_size() != c.sizeof(SceneStruct):
        raise MujocoError("the compiled engine is of another version: install the project again")
    engine.mujoco_outputs.argtypes = (c.c_void_p, c.c_void_p, c.c_void_p)
    engine.mujoco_step.argtypes = (*(c.c_void_p, c.c_double, c.c_double), c.c_void_p, c.c_void_p)
    engine.mujoco_handlers.restype = engine.mujoco_listen.restype = None
    engine.mujoco_listen.argtypes = (c.c_void_p,)
    engine.mujoco_handlers(*(c.byref(handler) for handler in handlers))
    return Functions(advance, evaluate, structs.address(engine.mujoco_step), engine.mujoco_outputs)


@contextmanager
def warnings() -> Iterator[list[str]]:
    """What MuJoCo warns of meanwhile, without a step: the first sentence, at the end."""
    functions()
    listener, heard = SceneStruct(), list[str]()
    structs.library().mujoco_listen(c.byref(listener))
    try:
        yield heard
    finally:
        structs.library().mujoco_listen(None)
    if listener.failed:
        heard.append(listener.text.decode("utf-8", "replace"))


def _library_file() -> str:
    """The shared library that the package has loaded."""
    from pathlib import Path

    folder = Path(str(package().__file__)).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    found = [path for name in names for path in sorted(folder.glob(name))]
    if not found:
        raise MujocoError(f"{folder} has no libmujoco; expected the package from PyPI: {INSTALL}")
    return str(found[0])
