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
from cosim.native import shared
from cosim.native.structs import MujocoStruct

INSTALL = "pip install 'cosim-bridge[mujoco]'"


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

    Raises MujocoError for a version of MuJoCo without one of them.
    """
    path = _library_file()
    try:
        mujoco = c.CDLL(path)
        advance, evaluate = shared.address(mujoco.mj_step), shared.address(mujoco.mj_forward)
        handlers = [c.c_void_p.in_dll(mujoco, f"mju_user_{word}") for word in ("error", "warning")]
    except (OSError, AttributeError, ValueError) as error:
        raise MujocoError(f"{path}: {error}; expected MuJoCo 4: {INSTALL}") from None
    engine = shared.library()
    engine.mujoco_handlers(*(c.byref(handler) for handler in handlers))
    return Functions(advance, evaluate, shared.address(engine.mujoco_step), engine.mujoco_outputs)


@contextmanager
def warnings() -> Iterator[list[str]]:
    """The warnings of MuJoCo meanwhile, without a step: the first sentence, at the end."""
    functions()
    listener, heard = MujocoStruct(), list[str]()
    shared.library().mujoco_listen(c.byref(listener))
    try:
        yield heard
    finally:
        shared.library().mujoco_listen(None)
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
