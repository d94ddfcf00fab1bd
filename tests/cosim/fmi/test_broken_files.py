"""FMUs that are broken in their files: one sentence of type FmuError each, and a fuzz over XML."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base import archive
from cosim.base.errors import CosimError, FmuError
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.file.description import read
from cosim.fmi.file.ports import groups
from cosim.fmi.file.values import parameter, port, settable
from fmus.models import planar2r
from tests.cosim.fmi.exporter import events3, export, library, nasty2, passing3, plan_of, run

Change = Callable[[str], str]


def replaced(old: str, new: str) -> Change:
    """A description with `old` in it, once, written as `new`."""

    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return change


BROKEN3: tuple[tuple[Change, str], ...] = (
    (lambda text: text[:-400], "not well-formed"),
    (lambda text: "", "not well-formed"),
    (lambda text: "\x00\xff", "not well-formed"),
    (lambda text: '<?xml version="1.0" encoding="klingon"?>' + text, "not well-formed"),
    (replaced("<fmiModelDescription", '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">'
              + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9))
              + "]><fmiModelDescription"), ""),
    (replaced('fmiVersion="3.0"', 'version="3.0"'), "fmiVersion is ''"),
    (replaced("<CoSimulation", "<ScheduledExecution"), "has no input clock"),
    (replaced('modelIdentifier="passing3"', 'modelIdentifier="../x"'), "expected a C identifier"),
    (replaced('name="u_Int8"', ""), "a variable has no 'name'"),
    (replaced('valueReference="102"', ""), "a variable has no 'valueReference'"),
    (replaced('valueReference="102"', 'valueReference="-1"'), "is not a 32-bit number"),
    (replaced('valueReference="102"', 'valueReference="99999999999"'), "is not a 32-bit number"),
    (replaced('valueReference="102"', 'valueReference="one"'), "invalid literal"),
    (replaced("<Int8 name", "<Complex name"), "of the unknown type 'Complex'"),
    (replaced('causality="input"', 'causality="sideways"'), "'sideways' is not one of parameter"),
    (replaced('variability="fixed"', 'variability="wobbly"'), "'wobbly' is not one of constant"),
    (replaced('declaredType="Mode"', 'declaredType="Nothing"'), "no type 'Nothing' is defined"),
    (replaced('value="2"', 'value="two"'), "its enumeration cannot be read"),
    (replaced('min="0"', 'min="11"'), "min 11 is above max 10"),
    (replaced('min="0"', 'min="low"'), "min or max is not a number"),
    (replaced('start="1 2 3 4"', 'start="1 2 x 4"'), "start 'x' is not a number"),
    (replaced('<Dimension valueReference="300"/>', '<Dimension valueReference="5"/>'),
     "'5' is neither a size nor the value reference"),
    (replaced('<Dimension valueReference="300"/>', '<Dimension start="-3"/>'), "'-3' is neither"),
    (replaced('<Dimension valueReference="300"/>', '<Dimension start="99999999999"/>'),
     "more than 1000000 entries"),
    (replaced('start="2"', 'start="two"'), "structural parameter 'n': start 'two' is not a size"),
    (replaced('kg="1"', 'kg="heavy"'), "unit 'Nm': invalid literal"),
    (replaced('factor="6.283185307179586"', 'factor="0"'), "unit 'turns': factor 0"),
    (replaced('factor="6.283185307179586"', 'factor="inf"'), "unit 'turns': factor inf"),
    (replaced("<ModelVariables>", '<DefaultExperiment stepSize="-1"/><ModelVariables>'),
     "stepSize '-1' is not a positive number"),
)  # fmt: skip


def entries(path: Path, **files: bytes) -> Path:
    """An archive."""
    with zipfile.ZipFile(path, "w") as target:
        for name, data in files.items():
            target.writestr(name.replace("__", "/").replace("_DOT_", "."), data)
    return path


@pytest.mark.parametrize(("change", "message"), BROKEN3)
def test_a_wrong_description_is_one_sentence(tmp_path: Path, change: Change, message: str) -> None:
    path = export(passing3(), tmp_path / "good.fmu")
    with zipfile.ZipFile(path) as good:
        files = {name: good.read(name) for name in good.namelist()}
    bad = tmp_path / "bad.fmu"
    with zipfile.ZipFile(bad, "w") as target:
        for name, data in files.items():
            changed = change(passing3()).encode("latin-1") if name.endswith(".xml") else data
            target.writestr(name, changed)
    if not message:  # entities that would unfold are refused, or never used: no harm either way
        FmuComponent(bad)
        return
    with pytest.raises(FmuError, match=message) as caught:
        FmuComponent(bad)
    assert str(caught.value).startswith(str(bad))
    assert "\n" not in str(caught.value)


def test_entities_that_unfold_without_end_are_refused(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9))
    bomb = passing3().replace(
        "<fmiModelDescription", f'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">{entities}]><fmiModelDescr'
        "iption", 1,
    ).replace('modelName="passing"', 'modelName="&j;"')  # fmt: skip
    path = tmp_path / "x.xml"
    path.write_text(bomb)
    with pytest.raises(FmuError, match="not well-formed"):
        read(path, Path("bomb.fmu"))


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "LARGEST", 1 << 20)
    path = tmp_path / "bomb.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        target.writestr("modelDescription.xml", passing3())
        target.writestr("resources/zeros", bytes(1 << 21))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(FmuError, match=r"would unpack to \d+ bytes; expected at most 1048576"):
        FmuComponent(path)


def test_a_description_without_end_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same archive, made by another test within two seconds, would be unpacked already."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(archive, "LARGEST_DESCRIPTION", 1000)
    with pytest.raises(FmuError, match=r"modelDescription.xml has \d+ bytes; expected at most"):
        FmuComponent(export(passing3(), tmp_path / "x.fmu"))


@pytest.mark.parametrize(
    "name", ["../out", "a/../../out", "/etc/out", "..\\out"],
)  # fmt: skip
def test_an_entry_that_would_leave_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    path = export(nasty2(), tmp_path / "slip.fmu")
    with zipfile.ZipFile(path, "a") as target:
        target.writestr(name, b"x")
    with pytest.raises(FmuError, match="would be written outside the folder"):
        FmuComponent(path)
    assert not list(tmp_path.parent.glob("out"))


@pytest.mark.parametrize("size", [10, 60, 200, 3000, 4000])
def test_part_of_a_library_is_refused(tmp_path: Path, size: int) -> None:
    path = tmp_path / "half.fmu"
    half = library("nasty2")[:size]
    with zipfile.ZipFile(path, "w") as target:
        target.writestr("modelDescription.xml", nasty2())
        target.writestr("binaries/linux64/nasty2.so", half)
    with pytest.raises(CosimError, match=r"cannot load nasty2\.so"):
        run(plan_of(path, 1))


@pytest.mark.parametrize("isolate", [False, True])
def test_functions_that_are_absent_are_named(tmp_path: Path, isolate: bool) -> None:
    wrong = events3().replace('modelIdentifier="events3"', 'modelIdentifier="passing3"')
    plan = plan_of(export(wrong, tmp_path / "x.fmu"), 1, options=FmuOptions(isolate=isolate))
    with pytest.raises(CosimError, match="the binary lacks fmi3UpdateDiscreteStates"):
        run(plan)


# ---- fuzz ---------------------------------------------------------------------------------------

_TOKENS = re.compile(r'"[^"]*"|<[^<>]*>|\w+')
_WORDS = ("", "0", "-1", "1e999", "nan", "99999999999999999999", "true", "input", "structural"
          "Parameter", "Clock", "String", "\u00e4", "&amp;", "1 2 3", "a[0]", "a[0,1]",
          "2.0", "3.0", '"', ">", "<x>", "[", "%s", "300")  # fmt: skip
_GOOD = (passing3(), events3(), nasty2())


@st.composite
def descriptions(draw: st.DrawFn) -> str:
    """One of ours with a few words, attributes or elements replaced, doubled or gone."""
    text = draw(st.sampled_from(_GOOD))
    for _ in range(draw(st.integers(1, 4))):
        places = [m.span() for m in _TOKENS.finditer(text)]
        if not places:
            break
        first, last = places[draw(st.integers(0, len(places) - 1))]
        piece = text[first:last]
        word = draw(st.sampled_from(_WORDS))
        quoted = f'"{word}"' if piece.startswith('"') else word
        text = text[:first] + draw(st.sampled_from([quoted, "", piece * 2])) + text[last:]
    return text


@given(descriptions())
def test_a_mutated_description_is_read_or_refused(text: str) -> None:
    path = Path(_FUZZ) / "modelDescription.xml"
    path.write_text(text, encoding="utf-8")
    try:
        found = read(path, Path("x.fmu"))
    except FmuError as error:
        assert str(error).startswith("x.fmu: ")
        return
    for group in groups(found.variables):
        if group.first.causality in ("input", "output") and settable(group):
            assert port(group).size == parameter(group).size


@pytest.fixture(scope="module", autouse=True)
def _folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    global _FUZZ
    _FUZZ = str(tmp_path_factory.mktemp("fuzz"))


_FUZZ = "."


def test_a_whole_fmu_of_a_mutated_description_starts_or_is_refused(tmp_path: Path) -> None:
    """Every attribute of our arm's description gone, one at a time: no exception but CosimError."""
    with zipfile.ZipFile(planar2r.fmu("3.0")) as good:
        text = good.read("modelDescription.xml").decode()
    path = tmp_path / "modelDescription.xml"
    refused = 0
    for match in list(re.finditer(r' [a-zA-Z]+="[^"]*"', text))[:250]:
        path.write_text(text[: match.start()] + text[match.end() :], encoding="utf-8")
        try:
            for group in groups(read(path, Path("x.fmu")).variables):
                port(group)
                parameter(group)
        except FmuError:
            refused += 1
    assert refused > 20
