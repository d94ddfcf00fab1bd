"""Components of the draft standard: what is in a file, what it needs, and messages about it."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from cosim.base import extras
from cosim.base.errors import FmuError, ScenarioError
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.file.validation import problems
from fmus import cli
from fmus.build.archive import find
from fmus.build.wasm_fmu import add_wasm
from fmus.models import planar2r, xi
from tests.cosim.sandbox.exporter import hostile

wasmtime = pytest.importorskip("wasmtime")

EXPORTED, IMPORTED = (
    ["fmi:fmi3/common@3.0.0", "fmi:fmi3/co-simulation@3.0.0"],
    ["fmi:fmi3/types@3.0.0", "fmi:fmi3/callbacks@3.0.0"],
)
#: The methods of the standard's resource, beside those that get and set each of 14 types.
METHODS = """set-debug-logging enter-initialization-mode exit-initialization-mode enter-event-mode
update-discrete-states terminate reset enter-configuration-mode exit-configuration-mode
get-number-of-variable-dependencies get-variable-dependencies get-fmu-state set-fmu-state
get-directional-derivative get-adjoint-derivative get-interval-decimal get-interval-fraction
get-shift-decimal get-shift-fraction set-interval-decimal set-interval-fraction set-shift-decimal
set-shift-fraction evaluate-discrete-states set-input-derivatives get-output-derivatives do-step
enter-step-mode"""
TYPES = """float32 float64 int8 int16 int32 int64 uint8 uint16 uint32 uint64 boolean string binary
clock"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile(tmp_path_factory.mktemp("fmu") / "hostile3.fmu")


def test_the_component_has_the_world_of_the_standard(path: Path) -> None:
    """Names as in its WIT files; nothing of WASI is imported."""
    with zipfile.ZipFile(path) as archive:
        content = archive.read("binaries/wasm32-wasip2/hostile3.wasm")
        manifest = ElementTree.fromstring(
            archive.read("extra/org.modelica.fmi-ls-wasm/manifest.xml")
        )
    from wasmtime import component

    engine = wasmtime.Engine()
    found = component.Component(engine, content).type
    assert [*found.imports(engine)] == IMPORTED
    assert [*found.exports(engine)] == EXPORTED
    functions = {*found.exports(engine)[EXPORTED[1]].ty.exports(engine)}
    methods = [*METHODS.split(), *(f"{v}-{t}" for v in ("get", "set") for t in TYPES.split())]
    assert {f for f in functions if f.startswith("[")} == {
        "[static]co-simulation-instance.instantiate-co-simulation",
        *(f"[method]co-simulation-instance.{method}" for method in methods),
    }
    space = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert manifest.get(f"{space}name") == "org.modelica.fmi-ls-wasm"


def test_the_file_is_the_same_whenever_it_is_made(path: Path, tmp_path: Path) -> None:
    again = hostile(tmp_path / "again.fmu")
    digests = {hashlib.sha256(p.read_bytes()).digest() for p in (path, again)}
    assert len(digests) == 1


def test_the_command_builds_and_the_file_validates(tmp_path: Path) -> None:
    done = CliRunner().invoke(
        cli.app, ["build", "xi", "--fmi", "3.0", "--wasm", "--out", str(tmp_path)]
    )
    assert done.exit_code == 0
    assert ", wasm" in done.output
    made = tmp_path / "xi.fmi3.fmu"
    assert not [*problems(made)]
    with zipfile.ZipFile(made) as new, zipfile.ZipFile(find(xi.model(), "3.0")) as old:
        assert {*old.namelist()} <= {*new.namelist()}


def test_fmi2_and_model_exchange_have_no_webassembly(tmp_path: Path) -> None:
    two = tmp_path / "two.fmu"
    two.write_bytes(planar2r.fmu("2.0").read_bytes())
    with pytest.raises(FmuError, match=r"found FMI 2\.0 for CoSimulation; expected FMI 3\.0"):
        add_wasm(two)
    for more in (["--fmi", "2.0"], ["--exchange"]):
        done = CliRunner().invoke(cli.app, ["build", "planar2r", "--wasm", *more])
        assert isinstance(done.exception, ScenarioError)


def test_isolate_needs_the_binary() -> None:
    x = FmuComponent(planar2r.fmu("3.0"), "x", options=FmuOptions(wasm=True))
    with pytest.raises(FmuError, match=r'isolate = "wasm" found no binaries/wasm32-wasip2/planar'):
        x.initialize({})


def test_without_wasmtime_one_sentence_says_what_to_install(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(ScenarioError, match=r"needs wasmtime: pip install 'cosim-bridge\[wasm\]'"):
        FmuComponent(path, "x").initialize({})


def test_info_names_the_platform(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cosim.cli.info import info

    info(str(path), validate=False)
    assert "wasm32-wasip2 (WebAssembly, on any platform)" in capsys.readouterr().out


#: A component that reads a file of its resources when it is instantiated, and traps unless it
#: begins with 7. It exports the interface of co-simulation without any function.
READER = """(component
  (import "fmi:fmi3/resource-dir-callbacks@3.0.0" (instance $dir (export "read-file"
    (func (param "path" string) (result (result (list u8) (error string)))))))
  (core module $memory
    (memory (export "memory") 1)
    (global $next (mut i32) (i32.const 1024))
    (func (export "realloc") (param i32 i32 i32 i32) (result i32)
      global.get $next
      (global.set $next (i32.add (global.get $next) (local.get 3)))))
  (core instance $m (instantiate $memory))
  (alias export $dir "read-file" (func $read))
  (core func $lowered (canon lower (func $read) (memory (core memory $m "memory"))
    (realloc (core func $m "realloc"))))
  (core module $main
    (import "dir" "read" (func $read (param i32 i32 i32)))
    (import "m" "memory" (memory 1))
    (data (i32.const 0) "NAME")
    (func $start
      (call $read (i32.const 0) (i32.const LENGTH) (i32.const 512))
      (if (i32.ne (i32.load8_u (i32.load (i32.const 516))) (i32.const 0x37)) (then unreachable)))
    (start $start))
  (core instance (instantiate $main (with "m" (instance $m))
    (with "dir" (instance (export "read" (func $lowered))))))
  (instance $nothing)
  (export "fmi:fmi3/co-simulation@3.0.0" (instance $nothing)))"""


@pytest.mark.parametrize(
    ("name", "found"),
    [("seven.txt", True), ("gone.txt", False), ("../secret.txt", False), ("/etc/passwd", False)],
)
def test_only_files_of_its_resources_are_read(tmp_path: Path, name: str, found: bool) -> None:
    from cosim.sandbox.runtime import Callbacks, Guest, Limits, Trap

    resources = tmp_path / "resources"
    resources.mkdir()
    (resources / "seven.txt").write_text("7")
    (tmp_path / "secret.txt").write_text("7")
    text = READER.replace("NAME", name).replace("LENGTH", str(len(name)))
    path = tmp_path / "reader.wasm"
    path.write_bytes(wasmtime.wat2wasm(text))
    callbacks = Callbacks(lambda *_: None, resources)
    if not found:
        with pytest.raises(FmuError, match=r"reader\.wasm cannot be instantiated: gave up"):
            Guest(path, Limits(10.0), callbacks)
        return
    guest = Guest(path, Limits(10.0), callbacks)
    with pytest.raises(Trap, match=r"does not export \[method\]co-simulation-instance\.do-step"):
        guest.function("do-step")
    guest.close()
