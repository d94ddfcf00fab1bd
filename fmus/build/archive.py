"""The way from a model to an ``.fmu``: compiled libraries, sources and descriptions in one archive.

One library serves FMI 2.0 and 3.0 and Python: it is compiled once and packed twice. The archive
has the same bytes whenever model, sources and compiler are the same.
"""

from __future__ import annotations

import html
import os
import re
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from pathlib import Path

from cosim.base.errors import FmuError
from fmus.build import toolchain
from fmus.build.description import Version, build_description, model_description, terminals
from fmus.build.library import compile_model, compile_models
from fmus.build.shipped import file_name, shipped
from fmus.build.source import sources, token
from fmus.model import Model, Variable, any_size

__all__ = [
    "ANY_SIZE",
    "SHIPPED",
    "VERSIONS",
    "Version",
    "build",
    "build_all",
    "find",
    "installed_models",
    "pack",
    "shipped_models",
    "versions",
]

VERSIONS: tuple[Version, ...] = ("2.0", "3.0")

#: What an installation brings as FMUs: models of ``fmus.models``, and the sizes of each.
SHIPPED: dict[str, tuple[dict[str, int], ...]] = {
    "planar2r": ({},),
    "arm": ({},),
    "operator": ({},),
    "xi": ({},),
    "teleoperation": (
        {"neighbours": 1},
        {"neighbours": 2},
        {"neighbours": 5},
        {"neighbours": 1, "gravity": 1},
    ),
    "adaptive": ({}, {"gravity": 1}),
    "damping": ({},),
    "friction": ({},),
    "pointmass": ({},),
    "pd": ({},),
    "p_d": ({},),
    "lee_spong": ({},),
    "nuno_adaptive": ({},),
    "chopra": ({},),
    "wang2014": ({},),
    "abdessameud2014": ({},),
    "wave_impedance": ({},),
    "wave_admittance": ({},),
    "wave_integral_impedance": ({},),
    "wave_integral_admittance": ({},),
    "tdpa_impedance": ({},),
    "tdpa_admittance": ({},),
    "endpoint_operator": ({},),
    "minimum_jerk": ({},),
    "reaction": ({},),
    "push": ({},),
    "decaying_push": ({},),
    "grasp": ({},),
    "encoder": ({},),
    "arm_teleoperation": ({},),
    "arm_task": ({}, {"coordinates": 6}),
    "arm_tip": ({},),
    "elastic_joint": ({},),
    "servo": ({},),
    "servo_command": ({},),
    "kinematic": ({},),
    "arm_pd": (),  # compiled when first used, as the next
    "arm_nuno_adaptive": (),
    "arm_chopra": (),
    "arm_wang2014": (),
    "arm_abdessameud2014": (),
    "arm_velocity": (),
}

#: Those of them that an installation also brings for any number of joints, of FMI 3.0.
ANY_SIZE = (
    "arm",
    "arm_teleoperation",
    "arm_pd",
    "arm_nuno_adaptive",
    "arm_chopra",
    "arm_wang2014",
    "arm_abdessameud2014",
    "pd",
    "encoder",
)

#: Options of the compiler that the numbers depend on, for who builds the sources in an FMU.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date a ZIP archive knows
_FOLDER2 = {"linux": "linux64", "windows": "win64", "darwin": "darwin64"}
_LICENCE = """\
SPDX-License-Identifier: Apache-2.0

The model description, the sources and the binaries in this FMU are licensed under the Apache
License, version 2.0: https://www.apache.org/licenses/LICENSE-2.0

Nothing else is linked into the binaries but the C library of the platform.
"""


def build(
    model: Model, version: Version, out_dir: Path | str, platforms: Sequence[str] | None = None
) -> Path:
    """Build ``out_dir/<identifier>.fmi2.fmu`` (or ``fmi3``) and return its path.

    `platforms`: of :data:`fmus.build.toolchain.PLATFORMS`; default the host's. Raises FmuError for
    an unknown version or a missing source, fmus.build.toolchain.ToolchainError from the compiler.
    """
    _check(model, version)
    return pack(model, version, out_dir, compile_model(model, platforms))


def build_all(
    out_dir: Path | str,
    models: Iterable[Model] | None = None,
    platforms: Sequence[str] | None = None,
) -> list[Path]:
    """Build `models` (default: those an installation has) in 2.0 and 3.0; `platforms` as above."""
    chosen = installed_models() if models is None else list(models)
    compiled = compile_models(chosen, platforms)
    return [
        pack(model, version, out_dir, binaries)
        for model, binaries in zip(chosen, compiled, strict=True)
        for version in versions(model)
    ]


def shipped_models() -> list[Model]:
    """The models of :data:`SHIPPED`, declared."""
    modules = {name: import_module(f"fmus.models.{name}") for name in SHIPPED}
    return [modules[name].model(**sizes) for name, many in SHIPPED.items() for sizes in many]


def installed_models() -> list[Model]:
    """The models of :data:`SHIPPED`, and those of :data:`ANY_SIZE` for any number of joints."""
    served = (import_module(f"fmus.models.{name}").model for name in ANY_SIZE)
    return [*shipped_models(), *map(any_size, served)]


def find(model: Model, version: Version) -> Path:
    """The FMU of `model` for the host: from the installation, the cache, or built into the cache.

    The cache is ``$XDG_CACHE_HOME/cosim/fmus`` (default ``~/.cache/cosim/fmus``), keyed by
    declaration and sources. Raises as :func:`build` does, and FmuError where the cache cannot be
    written.
    """
    _check(model, version)
    if found := shipped(model, version):
        return found
    name = file_name(model, version)
    folder = cache(model)
    if not _is_of(folder / name, model):
        binaries = compile_model(model)
        for each in versions(model):
            pack(model, each, folder, binaries)
    return folder / name


def cache(model: Model) -> Path:
    """The folder in the cache for what is made from `model`; it exists afterwards.

    Raises FmuError if it cannot be created.
    """
    return cache_folder(token(model))


def cache_folder(of: str) -> Path:
    """The folder in the cache for what is made from the model with a token. Raises FmuError."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(root) / "cosim" / "fmus" / of.strip("{}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FmuError(
            f"{folder}: cannot be created ({error.strerror}); set XDG_CACHE_HOME to a writable "
            "folder"
        ) from error
    return folder


def pack(
    model: Model, version: Version, out_dir: Path | str, binaries: Mapping[str, bytes]
) -> Path:
    """Write the archive of one version around compiled `binaries`, by platform; return its path.

    Raises FmuError for a version the model cannot be packed for.
    """
    _check(model, version)
    entries = {
        "modelDescription.xml": model_description(model, version),
        "documentation/index.html": _documentation(model, version),
        **licences(version),
        **{f"sources/{name}": text for name, text in sources(model).items()},
    }
    if version == "3.0":
        entries["sources/buildDescription.xml"] = build_description(model, FLAGS)
        if model.terminals:
            entries["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(model)
    content = {name: text.encode() for name, text in entries.items()}
    for platform, binary in binaries.items():
        suffix = toolchain.shared_suffix(platform)
        folder = platform if version == "3.0" else _folder2(platform, binaries)
        content[f"binaries/{folder}/{model.identifier}{suffix}"] = binary
    target = Path(out_dir) / file_name(model, version)
    write_archive(content, target)
    return target


def versions(model: Model) -> tuple[Version, ...]:
    """The FMI versions of `model`: FMI 2.0 has no clocks and no structural parameters."""
    return ("3.0",) if model.clock or model.structural else VERSIONS


def _check(model: Model, version: str) -> None:
    known = versions(model)
    if version not in known:
        has = "a clock" if model.clock else "a structural parameter" if model.structural else ""
        why = f"{model.identifier} has {has}; " if has and version == "2.0" else ""
        raise FmuError(f"{why}FMI version is {version!r}; expected one of {', '.join(known)}")


def _folder2(platform: str, platforms: Iterable[str]) -> str:
    """FMI 2.0's folder, which names no processor: x86_64 has it, or aarch64 where that is alone."""
    machine, _, system = platform.rpartition("-")
    if machine == "x86_64" or f"x86_64-{system}" not in platforms:
        return _FOLDER2[system]
    return platform


def write_archive(content: Mapping[str, bytes], target: Path) -> None:
    """Write a ZIP archive of exactly these names and contents, in one step.

    Raises FmuError if it cannot be written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.parent)
        with os.fdopen(handle, "wb") as file, zipfile.ZipFile(file, "w") as archive:
            for name in sorted(content):
                entry = zipfile.ZipInfo(name, _EPOCH)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3  # Unix, wherever this runs
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content[name])
        os.chmod(scratch, 0o644)
        os.replace(scratch, target)
    except OSError as error:
        raise FmuError(f"{target}: cannot be written: {error.strerror}") from error


@lru_cache(maxsize=64)
def _token_of(path: Path, changed: int) -> str:
    """The token an FMU was built with; `changed`, its modification time, is for the cache."""
    try:
        with zipfile.ZipFile(path) as archive:
            text = archive.read("modelDescription.xml").decode()
    except (OSError, KeyError, zipfile.BadZipFile):
        return ""
    found = re.search(r' (?:guid|instantiationToken)="([^"]*)"', text)
    return found[1] if found else ""


def _is_of(path: Path, model: Model) -> bool:
    """True if `path` is an FMU built from just this declaration and these sources."""
    return path.is_file() and _token_of(path, path.stat().st_mtime_ns) == token(model)


def licences(version: Version) -> dict[str, str]:
    """Entries of an archive with the licence of what is in it."""
    folder = "documentation/licenses"
    return {f"{folder}/license.txt": _LICENCE, f"{folder}/spdx.txt": "Apache-2.0\n"}


def _documentation(model: Model, version: Version) -> str:
    """The page that belongs to an FMU: equations and variables."""
    rows = "\n".join(_row(variable) for variable in model.variables)
    text = html.escape(model.documentation.strip() or model.description)
    return f"""\
<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{model.identifier}</title></head>
<body>
<h1>{model.identifier}</h1>
<p>{html.escape(model.description)}. FMI {version} for co-simulation, {model.kind},
{"clock every" if model.clock else "default step"} {model.step:g} s.</p>
<pre>
{text}
</pre>
<table>
<tr><th>name</th><th>causality</th><th>shape</th><th>unit</th><th>start</th><th></th></tr>
{rows}
</table>
</body>
</html>
"""


def _row(variable: Variable) -> str:
    start = ", ".join(f"{value:g}" for value in variable.starts)
    shape = " x ".join(map(str, variable.shape)) or "1"
    given = variable.causality in ("parameter", "input") or variable.settable
    cells = (
        variable.name,
        variable.causality,
        shape,
        variable.unit,
        start if given else "calculated",
        variable.description,
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
