"""Every FMU that is written here, of whatever kind, is valid by the schemas of the standards.

The schemas are those of the Modelica Association, as FMPy carries them.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import fmpy
import pytest
from lxml import etree

from cosim.bus.timing import BusTiming
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario
from cosim.ssp.container import write as write_container
from cosim.ssp.delays import build_delays
from fmus.build.archive import find, shipped_models
from fmus.build.bus_fmu import build_bus
from fmus.model import Model, clocked, exchanged
from fmus.models import pd, planar2r
from fmus.python import build_class
from tests.system.runs import scenario, teleoperation

SCHEMAS = Path(fmpy.__file__).parent / "schema"
#: The file of each schema in an FMU of FMI 3.0; other entries have none.
OTHERS = {
    "sources/buildDescription.xml": "fmi3BuildDescription.xsd",
    "terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons.xsd",
}
BOTH = [
    pytest.param(model, version, id=f"{model.identifier}-{version}")
    for model in shipped_models()
    for version in ("2.0", "3.0")
]


@lru_cache
def schema(version: str, name: str) -> etree.XMLSchema:
    return etree.XMLSchema(file=str(SCHEMAS / f"fmi{version}" / name))


def valid(fmu: Path) -> set[str]:
    """Assert that all XML with a schema is valid; the entries that were looked at."""
    with zipfile.ZipFile(fmu) as archive:
        names = {"modelDescription.xml"}
        root = etree.fromstring(archive.read("modelDescription.xml"))
        version = root.get("fmiVersion")[0]
        schema(version, f"fmi{version}ModelDescription.xsd").assertValid(root)
        for name, file in OTHERS.items():
            if version == "3" and name in archive.namelist():
                schema("3", file).assertValid(etree.fromstring(archive.read(name)))
                names.add(name)
    return names


@pytest.mark.parametrize(("model", "version"), BOTH)
def test_every_model(model: Model, version: str) -> None:
    found = valid(find(model, version))  # type: ignore[arg-type]
    assert len(found) == (3 if version == "3.0" else 1)


def loop() -> Scenario:
    """The teleoperator over constant delays, all stepped together."""
    document = teleoperation(stop=0.1)
    document["run"]["algorithm"] = "jacobi"
    for table in document["components"].values():
        table.pop("period", None)
    for link in document["links"]:
        link["delay"] = {"law": "constant", "delay": 0.05}
    return scenario(document)


def a_delay(folder: Path) -> Path:
    read = loop()
    return next(iter(build_delays(read, assemble(read), folder).values()))


def a_container(folder: Path) -> Path:
    read = loop()
    write_container(read, assemble(read), folder / "loop.fmu")
    return folder / "loop.fmu"


OWN: dict[str, Callable[[Path], Path]] = {
    "a clocked partition": lambda folder: find(clocked(pd.model(), 0.005), "3.0"),
    "a plant for model exchange, 2.0": lambda folder: find(exchanged(planar2r.model()), "2.0"),
    "a plant for model exchange, 3.0": lambda folder: find(exchanged(planar2r.model()), "3.0"),
    "a delay": a_delay,
    "a closed loop": a_container,
    "a CAN bus": lambda folder: build_bus(2, BusTiming(500e3), folder / "bus.fmu"),
    "a Python class": lambda folder: build_class("fmus.models.xi:Xi", folder),
}


@pytest.mark.parametrize("kind", OWN)
def test_everything_else_that_is_written(tmp_path: Path, kind: str) -> None:
    assert "modelDescription.xml" in valid(OWN[kind](tmp_path))


def test_a_wrong_description_is_noticed() -> None:
    with zipfile.ZipFile(find(pd.model(), "3.0")) as archive:
        text = archive.read("modelDescription.xml").replace(b'causality="input"', b'causality="in"')
    with pytest.raises(etree.DocumentInvalid):
        schema("3", "fmi3ModelDescription.xsd").assertValid(etree.fromstring(text))
