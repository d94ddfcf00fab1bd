"""``fmus``: build FMUs from models, list the models, validate FMUs, check files of robots.

Exit codes: 0 done, 1 an FMU has problems, 2 bad input or no compiler.
"""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from cosim.base.errors import ScenarioError, UnitError
from cosim.base.python import add_working_directory
from cosim.base.streams import open_standard_streams
from cosim.base.units import quantity
from cosim.cli.ending import ProgramGroup, run_program
from fmus.build.archive import ANY_SIZE, SHIPPED, VERSIONS, Version, pack, shipped_models, versions
from fmus.build.library import compile_model
from fmus.build.toolchain import PLATFORMS
from fmus.build.wasm_fmu import add_wasm
from fmus.firmware.folder import target_of
from fmus.firmware.folder import write as write_firmware
from fmus.firmware.measure import obstacle
from fmus.firmware.targets import TARGETS
from fmus.model import Model, any_size, clocked, exchanged

app = typer.Typer(
    name="fmus",
    cls=ProgramGroup,
    help="List the models, and build FMUs from them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


_Wasm = Annotated[
    bool, typer.Option("--wasm", help="With a WebAssembly binary as well: FMI 3.0, co-simulation.")
]
_Firmware = Annotated[
    str,
    typer.Option(
        metavar="|".join(TARGETS),
        help="No FMU, but C99 for this processor, with a check, its sizes and a README.",
    ),
]


@app.callback()
def _options() -> None:
    """List the models, and build FMUs from them."""


@app.command("build")
def build(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MODEL]...",
            help="Names in `fmus list`, a module, a file.py, or module:Class.",
            show_default="all",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the .fmu files.")] = Path("."),
    fmi: Annotated[str, typer.Option(help="2.0, 3.0 or both.")] = "both",
    platforms: Annotated[
        str,
        typer.Option(help=f"Comma-separated, or all: {', '.join(PLATFORMS)}.", show_default="host"),
    ] = "",
    sizes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Set a size of the model, e.g. neighbours=3; joints=any: 1 to 16 (FMI 3.0).",
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(help="Interval of a clock for sampled models, e.g. '5 ms' (FMI 3.0 only)."),
    ] = "",
    exchange: Annotated[
        bool, typer.Option("--exchange", help="For model exchange: of plants, as NAME_exchange.")
    ] = False,
    wasm: _Wasm = False,
    firmware: _Firmware = "",
) -> None:
    """Build FMUs with sources, for this machine or for others, or firmware."""
    asked, targets, given = _versions(fmi), _platforms(platforms), _sizes(sizes or [])
    if firmware:
        others = {"--fmi": fmi != "both", "--platforms": platforms, "--clock": clock}
        others |= {"--exchange": exchange, "--wasm": wasm, "--set joints=any": given is None}
        return _firmware(models or [], given or {}, out, firmware, others)
    for option, other in (("--clock", clock), ("--wasm", wasm)):
        if exchange and other:
            message = f"found --exchange with {option}, expected one of them"
            raise ScenarioError(message, "--exchange")
    if wasm and "3.0" not in asked:
        raise ScenarioError("found --fmi 2.0, expected 3.0 for WebAssembly", "--wasm")
    classes = [name for name in models or [] if ":" in name]
    for name in classes:
        from fmus.python import build_class

        typer.echo(f"{build_class(name, out)}  FMI 2.0, with Python inside")
    named = [name for name in models or [] if name not in classes]
    chosen = _clocked(_models(named, given), clock) if named or not classes else []
    for model in [exchanged(model) for model in chosen] if exchange else chosen:
        binaries = compile_model(model, targets)
        for version in (v for v in asked if v in versions(model) or fmi != "both"):
            path = pack(model, version, out, binaries)
            found = [*binaries, "wasm"] if wasm and version == "3.0" else [*binaries]
            if found[-1] == "wasm":
                add_wasm(path)
            typer.echo(f"{path}  FMI {version}, {', '.join(found)}")


def _firmware(
    names: list[str], sizes: dict[str, int], out: Path, name: str, others: dict[str, object]
) -> None:
    """Write each model as firmware: one into `out`, several into a folder of `out` each.

    `others`: options of FMUs, with a value that is true where they are given.
    """
    target, refused = target_of(name), [option for option, given in others.items() if given]
    if refused:
        raise ScenarioError(f"found {refused[0]}, which is about FMUs; leave it out", "--firmware")
    for one in names:
        if ":" in one:
            message = f"found the Python class {one}, expected a model in C: `fmus list` shows some"
            raise ScenarioError(message, "--firmware")
    chosen = _models(names, sizes)
    for model in chosen:
        folder = out if len(chosen) == 1 else out / model.identifier
        rows = write_firmware(model, target, folder)
        typer.echo(f"{folder / model.identifier}.c  {target.name}")
        for row in rows:
            typer.echo(f"  {row.text()}")
        if not rows and target.script:
            typer.echo(f"  not measured: {obstacle(target)}")


@app.command("wasm")
def wasm(fmu: Annotated[Path, typer.Argument(help="The .fmu file, with sources in C.")]) -> None:
    """Give an FMU of FMI 3.0 a WebAssembly binary, made from its sources (FMI-LS-WASM, draft)."""
    if not fmu.is_file():
        raise ScenarioError("no such file", str(fmu))
    typer.echo(f"{add_wasm(fmu)}  FMI 3.0, wasm")


@app.command("build-bus")
def build_bus_fmu(
    nodes: Annotated[int, typer.Option(help="CAN terminals: one for each node.", min=1, max=64)],
    out: Annotated[Path, typer.Option("--out", "-o", help="The .fmu file.")] = Path("bus.fmu"),
    bitrate: Annotated[float, typer.Option(help="bit/s; of FD frames, in arbitration.")] = 500e3,
    data_bitrate: Annotated[
        float | None, typer.Option(help="bit/s, in the data phase of CAN FD frames; makes it FD.")
    ] = None,
    platforms: Annotated[
        str,
        typer.Option(help=f"Comma-separated, or all: {', '.join(PLATFORMS)}.", show_default="host"),
    ] = "",
) -> None:
    """Build the simulated CAN bus as an FMU for other tools (FMI 3.0, FMI-LS-BUS 1.0)."""
    from cosim.bus.timing import BusTiming
    from fmus.build.bus_fmu import build_bus

    timing = BusTiming(bitrate, data_bitrate, data_bitrate is not None)
    made = build_bus(nodes, timing, out, _platforms(platforms))
    typer.echo(f"{made}  FMI 3.0, {nodes} CAN terminals, {bitrate:g} bit/s")


@app.command("list")
def list_models() -> None:
    """List the models of this package, with kind, sizes and default step."""
    for name in SHIPPED:
        module = _module(name)
        model, sizes = module.model(), ", ".join(inspect.signature(module.model).parameters)
        typer.echo(f"{name:14} {model.kind:11} {model.step:g} s  {model.description}")
        if sizes:
            typer.echo(f"{'':14} sizes: {sizes}")


@app.command("validate")
def validate(fmu: Annotated[Path, typer.Argument(help="The .fmu file.")]) -> None:
    """Check an FMU against the standard's schema and rules, with FMPy."""
    from cosim.fmi.file.validation import problems

    if not fmu.is_file():
        raise ScenarioError("no such file", str(fmu))
    found = problems(fmu)
    for problem in found:
        typer.echo(problem)
    typer.echo(f"{fmu}: {'no problems found' if not found else f'{len(found)} problem(s)'}")
    if found:
        raise typer.Exit(1)


@app.command("robot")
def robot(
    urdf: Annotated[Path, typer.Argument(help="The .urdf file.")],
    base: Annotated[str, typer.Option(help="Link where an arm begins.")] = "",
    tip: Annotated[str, typer.Option(help="Link where it ends.")] = "",
    held: Annotated[
        list[str] | None, typer.Option("--fixed", help="Hold a joint, e.g. finger=0; repeatable.")
    ] = None,
) -> None:
    """Check a URDF file: print its links or, with --base and --tip, the joints of an arm."""
    from fmus.arms.serial import serial
    from fmus.arms.urdf import read
    from fmus.robots import report

    if bool(base) != bool(tip):
        raise ScenarioError("found one of --base and --tip, expected both or none")
    lines = report.tree(read(urdf))
    if base:
        lines = report.joints(serial(urdf, base, tip, _held(held or [])))
    for line in lines:
        typer.echo(line)


def _held(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise ScenarioError(
                f"{text!r} is not JOINT=NUMBER, such as finger=0", "--fixed"
            ) from None
    return found


def _models(names: list[str], sizes: dict[str, int] | None) -> list[Model]:
    """The models asked for: all that are shipped where neither a name nor a size is given.

    `sizes` None: any number of joints.
    """
    if not names and sizes != {}:
        raise ScenarioError("sizes belong to a model; name it", "--set")
    if not names:
        return shipped_models()
    modules = [_module(name) for name in names]
    return [_any_size(m) if sizes is None else _model(m, sizes) for m in modules]


def _module(name: str) -> ModuleType:
    """The module of a model: ours by its short name, any that has ``model()``, or a file of it."""
    if name.endswith(".py"):
        from fmus.python import load_module

        return load_module(Path(name))
    full = name if "." in name else f"fmus.models.{name}"
    known = f"expected one of {', '.join(SHIPPED)}, or a module with a function model()"
    try:
        module = importlib.import_module(full)
    except ModuleNotFoundError as error:
        if error.name is None or not full.startswith(error.name):
            raise
        raise ScenarioError(f"no model {name!r}; {known}") from None
    if not callable(getattr(module, "model", None)):
        raise ScenarioError(f"{full} has no function model(); {known}")
    return module


def _model(module: ModuleType, sizes: dict[str, int]) -> Model:
    accepted = list(inspect.signature(module.model).parameters)
    for name in sizes:
        if name not in accepted:
            known = f"expected one of {', '.join(accepted)}" if accepted else "it has no sizes"
            raise ScenarioError(f"{module.__name__} has no size {name!r}; {known}", "--set")
    model = module.model(**sizes)
    if not isinstance(model, Model):
        raise ScenarioError(
            f"{module.__name__}.model() returns a {type(model).__name__}; expected a Model"
        )
    return model


def _any_size(module: ModuleType) -> Model:
    package, _, name = module.__name__.rpartition(".")
    if package == "fmus.models" and name not in ANY_SIZE:
        raise ScenarioError(
            f"{name} has no FMU for any number of joints; expected one of {', '.join(ANY_SIZE)}",
            "--set",
        )
    return any_size(module.model)


def _clocked(models: list[Model], interval: str) -> list[Model]:
    if not interval:
        return models
    try:
        seconds = quantity(interval, "s")
    except UnitError as error:
        raise ScenarioError(str(error), "--clock") from None
    return [clocked(model, seconds) for model in models]


def _versions(fmi: str) -> tuple[Version, ...]:
    if fmi == "both":
        return VERSIONS
    for version in VERSIONS:
        if fmi == version:
            return (version,)
    raise ScenarioError(f"{fmi!r} is not 2.0, 3.0 or both", "--fmi")


def _platforms(text: str) -> tuple[str, ...] | None:
    if text == "all":
        return PLATFORMS
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in PLATFORMS:
            raise ScenarioError(
                f"unknown platform {name!r}; expected all, or of {', '.join(PLATFORMS)}",
                "--platforms",
            )
    return names or None


def _sizes(texts: list[str]) -> dict[str, int] | None:
    """Sizes by name; None: any number of joints."""
    if texts == ["joints=any"]:
        return None
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name.strip()] = int(value)
        except ValueError:
            message = f"{text!r} is not NAME=INTEGER, such as neighbours=3, or joints=any alone"
            raise ScenarioError(message, "--set") from None
    return found


def main() -> None:
    """Entry point of the console script."""
    open_standard_streams()
    add_working_directory()
    run_program(app)
