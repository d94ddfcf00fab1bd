"""FMUs of sources in C and C++, with folders of headers, macros and libraries of their own."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

import cosim
from cosim.base.errors import CosimError
from cosim.record import Run
from tests.cosim.fmi.exporter import SOURCES, strict3
from tests.cosim.fmi.plain import SOURCE, P, U, Y, described, real

PLAIN = (real("u", U, "input", "2"), real("p", P, "parameter"), real("y", Y, "output"))
#: y = u + p + 100, by C++ and its library.
BESIDE = """
#include <numeric>
#include <vector>
extern "C" double beside(double x)
{
    const std::vector<double> both{x, 60.0, 40.0};
    try {
        if (both.size() == 3) throw both.size();
    } catch (std::vector<double>::size_type n) {
        return std::accumulate(both.begin(), both.begin() + n, 0.0);
    }
    return 0.0;
}
"""
#: What strict3.c needs to build here: a header in a folder, a macro, a function in C++.
NEEDS = """
#include "needed.h"
#if NEEDED != 7 || WANTED != 3
#error "a macro is missing"
#endif
extern double of_cpp(void);
double kept_of_cpp(void) { return of_cpp(); }
"""


def ran(path: Path, folder: Path) -> Run:
    document = {
        "run": {"step": 0.1, "stop": 0.2},
        "components": {"m": {"model": str(path), "build": True}},
    }
    cosim.run(document, out=folder / "run")
    return Run.open(folder / "run")


@pytest.mark.parametrize("listed", [True, False])
@pytest.mark.parametrize("end", ["cpp", "cc", "cxx"])
def test_sources_of_fmi_2_in_c_and_cpp(tmp_path: Path, end: str, listed: bool) -> None:
    names = f'<SourceFiles><File name="plain2.c"/><File name="sub/b.{end}"/></SourceFiles>'
    path = tmp_path / "both.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", described(PLAIN, inside=names if listed else ""))
        archive.writestr("sources/plain2.c", "#define BESIDE\n" + SOURCE.read_text())
        archive.writestr(f"sources/{'sub/' if listed else ''}b.{end}", BESIDE)
    assert ran(path, tmp_path).column("m.y")[-1] == 102.0


def built3(path: Path, configurations: str) -> Path:
    """An FMU of FMI 3.0 with this content of its buildDescription.xml."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", strict3())
        archive.writestr(
            "sources/buildDescription.xml",
            f'<fmiBuildDescription fmiVersion="3.0">{configurations}</fmiBuildDescription>',
        )
        archive.writestr("sources/a/strict3.c", NEEDS + (SOURCES / "strict3.c").read_text())
        archive.writestr("sources/b/more.txt", 'extern "C" double of_cpp(void) { return NEEDED; }')
        archive.writestr("sources/headers/needed.h", "#define NEEDED 7\n")
    return path


C_SET = (
    '<SourceFileSet language="C99"><SourceFile name="a/strict3.c"/>'
    '<PreprocessorDefinition name="WANTED" value="3"/><IncludeDirectory name="headers"/>'
    "</SourceFileSet>"
)
CPP_SET = (
    '<SourceFileSet language="C++11" compilerOptions="-include headers/needed.h">'
    '<SourceFile name="b/more.txt"/><IncludeDirectory name="headers"/></SourceFileSet>'
)
OTHER = '<BuildConfiguration modelIdentifier="another"><SourceFileSet/></BuildConfiguration>'


def configuration(inside: str, more: str = "") -> str:
    return (
        f'{OTHER}<BuildConfiguration modelIdentifier="strict3" {more}>{inside}</BuildConfiguration>'
    )


def test_each_set_of_sources_has_its_language_macros_and_folders(tmp_path: Path) -> None:
    sets = C_SET + CPP_SET.replace("-include headers/needed.h", "-include needed.h")
    path = built3(tmp_path / "sets.fmu", configuration(sets + '<Library name="m"/>'))
    assert ran(path, tmp_path).column("m.y")[0] == 1.0


@pytest.mark.parametrize(
    ("inside", "more", "said"),
    [
        (C_SET.replace("C99", "Fortran90"), "", "has sources in Fortran90; expected C or C"),
        (C_SET.replace("headers", "gone"), "", "lists the include folder 'gone', which is not th"),
        (C_SET.replace("headers", "../binaries"), "", "lists the include folder '../binaries'"),
        (C_SET.replace("a/strict3", "strict3"), "", "lists the source 'strict3.c', which is not"),
        (C_SET, 'platform="x86_64-plan9"', "builds another (any platform), strict3 (x86_64-plan9)"),
        (C_SET + CPP_SET + '<Library name="no_such_one"/>', "", "no_such_one"),
    ],
)
def test_what_cannot_be_built_is_refused_by_name(
    tmp_path: Path, inside: str, more: str, said: str
) -> None:
    inside = inside.replace("-include headers/needed.h", "-include needed.h")
    path = built3(tmp_path / "bad.fmu", configuration(inside, more))
    with pytest.raises(CosimError) as caught:
        ran(path, tmp_path)
    assert said in str(caught.value)
