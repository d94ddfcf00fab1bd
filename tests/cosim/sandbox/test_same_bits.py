"""WebAssembly gives what the native binary gives: types, clocks, events, states, all models."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("wasmtime")

from cosim.base.component import Component
from cosim.fmi import FmuComponent, FmuOptions
from fmus.build.archive import find, installed_models, versions
from fmus.build.wasm_fmu import add_wasm
from fmus.models import planar2r, xi
from tests.cosim.fmi.exporter import (
    SOURCES,
    TYPES3,
    clocked3,
    column,
    events3,
    export,
    passing3,
    plan_of,
    run,
    timed3,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmu")


def both(description: str, folder: Path) -> tuple[Path, Path]:
    """An FMU with a native binary, and one with WebAssembly only."""
    native = export(description, folder / "native.fmu")
    wasm = export(description, folder / "wasm.fmu", sources=True)
    with zipfile.ZipFile(wasm, "a") as archive:
        for name in ("saved3.h", "unused3.h"):
            archive.write(SOURCES / name, f"sources/{name}")
    return native, add_wasm(wasm)


def with_wasm(model, folder: Path) -> Path:
    """The installed FMU of a model with a WebAssembly binary as well."""
    path = folder / f"{model.identifier}.fmu"
    shutil.copy(find(model, "3.0"), path)
    return add_wasm(path)


def rows_of(path: Path, feed: dict[str, np.ndarray], steps: int, h: float, **options) -> bytes:
    found, engine = run(plan_of(path, steps, h=h, options=FmuOptions(**options)), feed)
    with engine:
        return found.tobytes()


def feeds(component: Component, steps: int) -> dict[str, np.ndarray]:
    """Inputs that move, of any shape; whole numbers stay as they start."""
    found = {}
    for i, port in enumerate(component.inputs):
        t = np.arange(steps * port.size, dtype=float)
        found[port.name] = 0.3 * np.sin(0.1 * t + i).reshape(steps, port.size)
    return found


def test_every_type_passes_exactly(folder: Path) -> None:
    """The size of an array is set, too."""
    native, wasm = both(passing3(), folder)
    rows = {}
    for path in (native, wasm):
        plan = plan_of(
            path, 3, options=FmuOptions(sizes={"n": 3}, texts={"label": "hé", "blob": "01ff"})
        )
        feed = {f"u_{kind}": np.array([1.0, 0.0, 1.0]) for kind in TYPES3 if kind != "Enumeration"}
        feed["u_Enumeration"] = np.array([1.0, 2.0, 1.0])
        feed["A"] = np.arange(27.0).reshape(3, 9)
        found, engine = run(plan, feed)
        with engine:
            rows[path] = found.tobytes(), engine.texts()
            assert column(plan, found, "B").shape == (4, 3, 3)
    assert rows[native] == rows[wasm]
    assert rows[wasm][1]["x.said"] == ["hé"]


@pytest.mark.parametrize("description", [events3, clocked3, timed3])
def test_events_and_clocks_are_the_same(description, folder: Path) -> None:
    native, wasm = both(description(), folder)
    rows = []
    for path in (native, wasm):
        plan = plan_of(path, 20, h=0.1)
        found, engine = run(plan)
        with engine:
            rows.append((found.tobytes(), engine.texts(), engine.bound.late_clock_ticks()))
    assert rows[0] == rows[1]


@pytest.mark.parametrize("model", [planar2r, xi])
def test_models_give_the_same_bits(model, folder: Path) -> None:
    path = with_wasm(model.model(), folder)
    feed = feeds(FmuComponent(path), 1000)
    native = rows_of(path, feed, 1000, model.model().step)
    assert rows_of(path, feed, 1000, model.model().step, wasm=True) == native


def test_an_instance_is_called_by_python_after_c_has_its_functions(folder: Path) -> None:
    """The functions of a component are shared, and the types of their arguments are not."""
    path = with_wasm(xi.model(), folder)
    x = FmuComponent(path, "x", options=FmuOptions(wasm=True))
    x.initialize({})
    x.exit_initialization()
    x.step(0.0, 0.005, {})
    x.instance.loop_functions()  # with types of their own, none
    assert x.step(0.005, 0.005, {}).keys() == {p.name for p in x.outputs}
    x.close()


def test_a_saved_state_is_that_of_the_native_binary(folder: Path) -> None:
    path = with_wasm(planar2r.model(), folder)
    found = []
    for wasm in (False, True):
        x = FmuComponent(path, "x", options=FmuOptions(wasm=wasm))
        x.initialize({})
        x.exit_initialization()
        x.step(0.0, 0.001, {"tau": np.array([1.0, 2.0])})
        state = x.get_state()
        first = x.step(0.001, 0.001, {"tau": np.array([3.0, -1.0])})
        x.set_state(state)
        again = x.step(0.001, 0.001, {"tau": np.array([3.0, -1.0])})
        x.instance.free_state(state)
        x.close()
        assert {k: v.tobytes() for k, v in first.items()} == {
            k: v.tobytes() for k, v in again.items()
        }
        found.append({k: v.tobytes() for k, v in again.items()})
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", [m for m in installed_models() if "3.0" in versions(m)], ids=lambda m: m.identifier
)
def test_all_installed_models_give_the_same_bits(model, folder: Path) -> None:
    path = with_wasm(model, folder)
    feed = feeds(FmuComponent(path), 1000)
    native = rows_of(path, feed, 1000, model.step)
    assert rows_of(path, feed, 1000, model.step, wasm=True) == native
