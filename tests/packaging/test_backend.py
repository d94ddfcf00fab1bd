"""The build backend: what it asks for, what it makes, and what gets into wheel and sdist."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from fmus.build.toolchain import host_compiler, shared_suffix

ROOT = Path(__file__).resolve().parents[2]
ENGINE = f"cosim/_engine{shared_suffix()}"
PAGE, MODELS = "cosim/_engine.wasm", "fmus/_built/models.wasm.xz"
BUS = f"cosim/_bus{shared_suffix()}"
BRIDGE = f"bridge/_bridge{shared_suffix()}"
ENDINGS = (
    ".py",
    ".pyi",
    ".c",
    ".h",
    ".ld",
    ".md",
    ".fmu",
    "_built/built.json",
    "_built/models.wasm.json",
    "c/wasm/world.bin",
    MODELS,
    PAGE,
    "py.typed",
    ".css",
    ".js",
    "/init.sh",
    "uPlot-LICENSE.txt",
    ENGINE,
    BUS,
    BRIDGE,
)
PARTS = ("cosim", "fmus", "bridge", "build_backend", "configs")
FILES = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CONTRIBUTING.md", "CHANGELOG.md")


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The backend of this checkout, looking for a compiler anew."""
    monkeypatch.syspath_prepend(str(ROOT / "build_backend"))
    monkeypatch.chdir(ROOT)
    import cosim_build

    host_compiler.cache_clear()
    yield cosim_build
    host_compiler.cache_clear()


def copy_of_the_sources(folder: Path) -> Path:
    made = ("*.fmu", "built.json", "_engine.json", "_engine.[sd]*", "_bus.*", "__pycache__")
    skip = shutil.ignore_patterns(*made)
    for part in PARTS:
        shutil.copytree(ROOT / part, folder / part, ignore=skip)
    for name in FILES:
        shutil.copy(ROOT / name, folder)
    return folder


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the sources with the compiled parts made; tests leave it up to date."""
    folder = copy_of_the_sources(tmp_path_factory.mktemp("project"))
    assert ENGINE in make(folder)
    return folder


def make(folder: Path) -> list[str]:
    """Make the compiled parts; the names of those made now."""
    command = [sys.executable, "build_backend/compiled.py"]
    return run(command, folder).split()


def run(command: list[str], folder: Path) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def hook(folder: Path, name: str, target: Path) -> Path:
    """Call a build hook the way a front end does: in a process of its own, in the sources."""
    target.mkdir(exist_ok=True)
    script = (
        "import sys; sys.path.insert(0, 'build_backend'); import cosim_build; "
        f"print(); print(cosim_build.{name}(sys.argv[1]))"
    )
    return target / run([sys.executable, "-c", script, str(target)], folder).split()[-1]


@pytest.mark.parametrize("kind", ["wheel", "editable"])
def test_zig_is_asked_for_only_where_it_has_something_to_compile(
    backend: ModuleType, kind: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    requires = getattr(backend, f"get_requires_for_build_{kind}")
    monkeypatch.setenv("CC", "cc")
    assert not any("ziglang" in requirement for requirement in requires())
    with monkeypatch.context() as old:
        old.setattr(backend.compiled, "WEB_UNITS", ("engine.c",))
        assert any("ziglang" in requirement for requirement in requires()), "old WebAssembly"
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    host_compiler.cache_clear()
    assert any("ziglang" in requirement for requirement in requires()), "no compiler"


def test_the_webassembly_in_the_repository_is_that_of_the_sources(backend: ModuleType) -> None:
    """A build renews it; it is then committed with the change of the sources."""
    for (stamp, made_from), name in zip(
        backend.compiled._pages(), (f"{PAGE}.json", "fmus/_built/models.wasm.json"), strict=True
    ):
        assert stamp == ROOT / name
        show = ["git", "-c", "safe.directory=*", "show", f"HEAD:{name}"]
        committed = json.loads(run(show, ROOT))
        assert committed["made_from"] == made_from, f"{name}: commit the one of the last build"
        assert backend.compiled._current(stamp, made_from)


def test_a_source_distribution_needs_no_compiler(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not any("ziglang" in need for need in backend.get_requires_for_build_sdist())


class Pip:
    """A pip that "downloads" a wheel with the files of uPlot, or fails."""

    def __init__(self, *, works: bool) -> None:
        self.works, self.calls = works, list[list[str]]()

    def run(self, call: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        self.calls.append(call)
        if self.works and "download" in call:
            with zipfile.ZipFile(Path(call[call.index("-d") + 1], "uplot.whl"), "w") as wheel:
                for name in ("uPlot.iife.js", "uPlot.min.css"):
                    wheel.writestr(f"uplot/static/{name}", name)
        return subprocess.CompletedProcess(call, 0 if self.works else 1)


@pytest.fixture
def page_files(backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of uPlot's files, empty; no ``uplot-python`` is installed."""
    monkeypatch.setattr(backend.plots, "FOLDER", tmp_path)
    monkeypatch.setattr(backend.plots, "find_spec", lambda _: None)
    return tmp_path


def test_files_of_uplot_are_taken_from_its_wheel_without_its_requirements(
    backend: ModuleType, page_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pip = Pip(works=True)
    monkeypatch.setattr(subprocess, "run", pip.run)
    assert "uplot-python>=1.1" not in backend._others()
    assert {f.name: f.read_text() for f in page_files.iterdir()} == {
        name: name for name in ("uPlot.iife.js", "uPlot.min.css")
    }
    assert backend.plots.take() == []
    (call,) = [call for call in pip.calls if "download" in call]
    assert {"-I", "--no-deps", "uplot-python>=1.1"} <= set(call)


def test_without_pip_the_package_of_uplot_is_asked_for(
    backend: ModuleType, page_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host_compiler()  # looked for before nothing can be called
    monkeypatch.setattr(subprocess, "run", Pip(works=False).run)
    assert backend._others()[-1] == "uplot-python>=1.1"
    with pytest.raises(ModuleNotFoundError, match="pip install 'uplot-python"):
        backend.plots.take()
    assert not list(page_files.iterdir())


@pytest.mark.slow
def test_what_is_up_to_date_is_left_alone(built: Path) -> None:
    assert make(built) == []
    (built / ENGINE).unlink()
    assert make(built) == [ENGINE]


@pytest.mark.slow
def test_a_change_in_c_is_built(built: Path) -> None:
    with (built / "cosim" / "c" / "engine.c").open("a") as source:
        source.write("/* changed */\n")
    assert make(built) == [ENGINE, PAGE]
    assert make(built) == []


@pytest.mark.slow
def test_an_fmu_whose_model_has_gone_goes_too(built: Path) -> None:
    known = set((built / "fmus" / "_built").glob("*.fmu"))
    (built / "fmus" / "_built" / "renamed.fmu").write_bytes(b"old")
    (built / "fmus" / "c" / "note.h").write_text("/* a change */\n")
    made = make(built)
    assert len(made) == len(known) + 1 > 1
    assert MODELS in made
    assert set((built / "fmus" / "_built").glob("*.fmu")) == known


@pytest.mark.slow
def test_the_stamp_names_what_was_made(built: Path) -> None:
    stamp = json.loads((built / "fmus" / "_built" / "built.json").read_text())
    assert set(stamp["files"]) == {p.name for p in (built / "fmus" / "_built").glob("*.fmu")}


@pytest.fixture(scope="module")
def wheel(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel, made where an earlier version has left its traces."""
    old = built / "build" / "lib" / "cosim" / "old_module.py"
    old.parent.mkdir(parents=True)
    old.write_text("")
    return hook(built, "build_wheel", tmp_path_factory.mktemp("wheel"))


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.slow
def test_a_wheel_is_for_one_platform_and_any_python_3(wheel: Path) -> None:
    python, abi, platform = wheel.stem.split("-")[2:]
    assert (python, abi) == ("py3", "none")
    assert platform != "any"


@pytest.mark.slow
def test_a_wheel_holds_packages_engine_and_fmus(wheel: Path, built: Path) -> None:
    found = names(wheel)
    python = {
        path.relative_to(built).as_posix()
        for package in ("cosim", "fmus", "bridge")
        for path in (built / package).rglob("*.py")
    }
    folders = (built / package / "c" for package in ("cosim", "fmus", "bridge"))
    c = {path.relative_to(built).as_posix() for f in folders for path in f.rglob("*.[ch]")}
    fmus = {f"fmus/_built/{path.name}" for path in (built / "fmus" / "_built").glob("*.*")}
    assert "fmus/_built/built.json" in fmus
    typed = {f"{package}/py.typed" for package in ("cosim", "fmus", "bridge")}
    assert fmus
    assert {ENGINE, PAGE, BUS} | python | c | fmus | typed <= found


@pytest.mark.slow
def test_a_wheel_holds_nothing_else(wheel: Path) -> None:
    for name in names(wheel):
        assert name.startswith(("cosim/", "fmus/", "bridge/", "cosim_bridge-"))
        assert name.endswith(ENDINGS) or ".dist-info/" in name
    assert "cosim/old_module.py" not in names(wheel)


@pytest.mark.slow
def test_building_leaves_the_sources_as_they_were(wheel: Path, built: Path) -> None:
    assert {path.name for path in built.iterdir()} == {*PARTS, *FILES, "build"}


@pytest.mark.slow
@pytest.mark.slow
def test_an_sdist_holds_sources_only_and_makes_the_same_wheel(
    wheel: Path, built: Path, tmp_path: Path
) -> None:
    archive = hook(built, "build_sdist", tmp_path / "dist")
    with tarfile.open(archive) as sdist:
        assert not [n for n in sdist.getnames() if n.endswith((".so", ".dylib", ".dll", ".fmu"))]
        sdist.extractall(tmp_path, filter="data")
    again = hook(tmp_path / archive.name.removesuffix(".tar.gz"), "build_wheel", tmp_path / "again")
    assert again.name == wheel.name
    assert names(again) == names(wheel)
