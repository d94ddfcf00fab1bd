"""Files made of C, in place: ``cosim/_engine.so``, ``cosim/_bus.so``, ``bridge/_bridge.so``,
``bridge/_preload.so``, ``fmus/_built/*.fmu``, and ``enums.py`` and ``structs.py`` of the packages
that call the libraries; engine and models as WebAssembly, and the two files of uPlot that reports
contain.

``python build_backend/compiled.py`` makes them for work from a checkout; installing does the
same. What is up to date, by the contents of everything it is made from, is left alone.

Of about 10 s of processor time, engine and bridge take 3 and the models 7: 6 for the compilers (the
FMI layer once, then two small C files and a link for each of 28 libraries), 1 for the archives.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: C files of the engine in a page, which has no MuJoCo.
WEB_UNITS = ("ages.c", "engine.c", "mailbox.c", "start.c", "tables.c")


def build(platform: str | None = None) -> list[Path]:
    """Make what is missing or old; return the files made now.

    `platform`: of fmus.build.toolchain.PLATFORMS; default the host's. Raises
    fmus.build.toolchain.ToolchainError where there is no compiler or it refuses the sources.
    """
    for folder in (ROOT, ROOT / "build_backend"):
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))
    import c_structs
    import plots

    made = [*c_structs.write(), *_libraries(platform), *_models(platform)]
    return [*made, *_web(), *plots.take()]


def _libraries(platform: str | None) -> list[Path]:
    """The engine, the bus and the bridge; for Linux, what is loaded into programs of a bus."""
    from fmus.build.toolchain import shared_suffix

    engine, bus, bridge = ROOT / "cosim/c", ROOT / "cosim/c/bus", ROOT / "bridge/c"
    length, made = bus / "length.c", []
    for output, units, headers in (
        ("cosim/_engine", [*engine.glob("*.c")], [*engine.glob("*.h"), *engine.glob("engine/*")]),
        ("cosim/_bus", [*bus.glob("*.c")], [*bus.glob("*.h")]),
        ("bridge/_bridge", [*bridge.glob("*.c"), length],
         [*bridge.glob("*.h"), *engine.glob("*.h"), *bus.glob("*.h")]),
    ):  # fmt: skip
        made += _library(output, sorted(units), headers, platform)
    if shared_suffix(platform) == ".so":  # programs in the time of a simulated bus
        preload, flags = ROOT / "bridge/c/preload", ("-Wl,--no-as-needed", "-ldl", "-lpthread")
        sources, headers = sorted(preload.glob("*.c")), [*preload.glob("*.h")]
        made += _library("bridge/_preload", sources, headers, platform, flags)
    return made


def _library(
    name: str,
    units: list[Path],
    headers: list[Path],
    platform: str | None,
    flags: tuple[str, ...] = (),
) -> list[Path]:
    """A shared library of `units`, made again when one of its sources has changed."""
    from fmus.build.toolchain import compile_shared, shared_suffix

    output = ROOT / f"{name}{shared_suffix(platform)}"
    made_from = _fingerprint([*units, *headers, ROOT / "fmus/build/toolchain.py"], platform)
    stamp = output.with_name(f"{output.stem}.json")
    if _current(stamp, made_from):
        return []
    include = [units[0].parent, ROOT / "cosim/c"]
    compile_shared(units, output, include=include, platform=platform, flags=flags)
    _write(stamp, made_from, [output])
    return [output]


def _models(platform: str | None) -> list[Path]:
    """All FMUs; those of models that are no longer there go."""
    from fmus.build import shipped

    folder = ROOT / "fmus" / "_built"
    made_from = _fingerprint(shipped.made_from(), platform)
    stamp = folder / shipped.STAMP
    if _current(stamp, made_from):
        return []
    from fmus.build.archive import build_all, installed_models, versions

    models, platforms = installed_models(), None if platform is None else [platform]
    built = [path.resolve() for path in build_all(folder, models, platforms)]
    for path in set(folder.glob("*.fmu")) - set(built):
        path.unlink()
    index = shipped.index((model, version) for model in models for version in versions(model))
    _write(stamp, made_from, built, **index)
    return built


def _web() -> list[Path]:
    """The engine and the models as WebAssembly, where they are not those of the sources."""
    from fmus.build import wasm
    from fmus.build.archive import installed_models

    made, (engine, models) = [], _pages()
    if not _current(*engine):
        units = [ROOT / "cosim/c" / name for name in WEB_UNITS]
        made.append(wasm.engine(units, engine[0].with_suffix(""), [ROOT / "cosim/c"]))
        _write(*engine, made)
    if not _current(*models):
        packed = wasm.pack(installed_models(), models[0].with_name(wasm.ARCHIVE))
        _write(*models, [packed])
        made.append(packed)
    return made


def _pages() -> tuple[tuple[Path, str], tuple[Path, str]]:
    """The stamps of engine and models as WebAssembly, and the digests of their sources."""
    from fmus.build import shipped

    folder = ROOT / "cosim/c"
    units = [folder / name for name in WEB_UNITS]
    headers = [*folder.glob("*.h"), *folder.glob("engine/*")]
    builder = [ROOT / "fmus/build/wasm.py", ROOT / "fmus/build/toolchain.py"]
    return (
        (ROOT / "cosim/_engine.wasm.json", _contents([*units, *headers, *builder])),
        (ROOT / "fmus/_built/models.wasm.json", _contents(shipped.made_from())),
    )


def pages_are_current() -> bool:
    """True if the WebAssembly that the repository has is that of the sources.

    It is the same on every platform, so it is committed: who installs does not need zig for it.
    """
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    return all(_current(*page) for page in _pages())


def _fingerprint(files: Iterable[Path], platform: str | None) -> str:
    """SHA-256 of names and contents, and of the compiler for a platform."""
    from fmus.build.toolchain import compiler, host_platform

    name = platform or host_platform()
    return _contents(files, repr((name, compiler(name)[1:])))


def _contents(files: Iterable[Path], more: str = "") -> str:
    """SHA-256 of names and contents of files."""
    digest = hashlib.sha256(more.encode())
    for path in sorted(files):
        digest.update(f"{path.relative_to(ROOT).as_posix()}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _current(stamp: Path, made_from: str) -> bool:
    """True if a stamp names these sources, and its files are there as they were written."""
    if not stamp.is_file():
        return False
    known = json.loads(stamp.read_text())
    return known["made_from"] == made_from and all(
        (stamp.parent / name).is_file() and _sha256(stamp.parent / name) == digest
        for name, digest in known["files"].items()
    )


def _write(stamp: Path, made_from: str, files: Iterable[Path], **more: object) -> None:
    digests = {path.name: _sha256(path) for path in sorted(files)}
    content = {"made_from": made_from, "files": digests, **more}
    stamp.write_text(json.dumps(content, indent=2) + "\n")


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    for made in build():
        print(made.relative_to(ROOT))
