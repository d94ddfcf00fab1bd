"""The XML files of an FMU, for FMI 2.0.5 and FMI 3.0.2, from a model's declaration.

An annotation in both gives the kind of the FMU, sampled or continuous, which the schedule uses
(:mod:`cosim.base.component`); other tools ignore it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cosim.base.errors import FmuError
from fmus.build import description2, description3
from fmus.build.source import c_files
from fmus.model import Model

Version = Literal["2.0", "3.0"]


def model_description(model: Model, version: Version) -> str:
    """``modelDescription.xml`` of `model`. Raises FmuError for a version that is neither."""
    if version == "2.0":
        return xml_text(description2.describe(model))
    if version == "3.0":
        return xml_text(description3.describe(model))
    raise FmuError(f"FMI version is {version!r}; expected '2.0' or '3.0'")


def build_description(model: Model, flags: Iterable[str]) -> str:
    """``sources/buildDescription.xml`` of FMI 3.0; `flags` are compiler options that matter."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = SubElement(
        configuration, "SourceFileSet", language="C99", compilerOptions=" ".join(flags)
    )
    for name in c_files(model):
        SubElement(files, "SourceFile", name=name)
    return xml_text(root)


def terminals(model: Model) -> str:
    """``terminalsAndIcons/terminalsAndIcons.xml`` of FMI 3.0, for a model that has terminals."""
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = SubElement(root, "Terminals")
    for terminal in model.terminals:
        element = SubElement(listed, "Terminal", name=terminal.name, matchingRule="bus")
        if terminal.description:
            element.set("description", terminal.description)
        for name in terminal.members:
            SubElement(
                element,
                "TerminalMemberVariable",
                variableName=name,
                memberName=name,
                variableKind="signal",
            )
    return xml_text(root)


def xml_text(root: Element) -> str:
    """An XML document, indented."""
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
