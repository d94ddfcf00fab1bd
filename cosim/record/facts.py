"""The entries of ``run.json`` that readers use, with their types; others may be there as well."""

from __future__ import annotations

from typing import Any

from msgspec import UNSET, Struct, UnsetType, ValidationError, convert

from cosim.base.errors import ScenarioError


class _Finding(Struct):
    severity: str
    where: str
    reason: str
    rule: str
    advice: str | UnsetType = UNSET


class _Ended(Struct):
    component: str
    time: float


class _Record(Struct):
    every: int | UnsetType = UNSET


class _Running(Struct):
    step: float | str | UnsetType = UNSET
    record: _Record | UnsetType = UNSET


class _Component(Struct):
    model: str | UnsetType = UNSET
    preset: str | UnsetType | None = UNSET
    period: float | str | UnsetType | None = UNSET
    parameters: dict[str, Any] | UnsetType | None = UNSET
    start: dict[str, Any] | UnsetType | None = UNSET
    options: dict[str, Any] | UnsetType | None = UNSET


class _Event(Struct):
    set: dict[str, Any]
    at: float | str | UnsetType | None = UNSET


class _Scenario(Struct):
    title: str | UnsetType = UNSET
    path: str | UnsetType = UNSET
    run: _Running | UnsetType = UNSET
    components: dict[str, _Component] | UnsetType = UNSET
    figures: dict[str, Any] | UnsetType = UNSET
    events: list[_Event] | UnsetType | None = UNSET


class _Fmu(Struct):
    file: str
    fmi: str
    sha256: str


class _Link(Struct):
    delay: dict[str, Any] | UnsetType | None = UNSET


class _Facts(Struct):
    status: str | UnsetType = UNSET
    scenario: _Scenario | UnsetType = UNSET
    seed: int | UnsetType = UNSET
    step: float | UnsetType = UNSET
    ticks: int | UnsetType = UNSET
    algorithm: str | UnsetType = UNSET
    order: list[str] | UnsetType = UNSET
    versions: dict[str, str] | UnsetType = UNSET
    fmus: dict[str, _Fmu] | UnsetType = UNSET
    files: dict[str, str] | UnsetType = UNSET
    links: dict[str, _Link] | UnsetType = UNSET
    weights: dict[str, Any] | UnsetType = UNSET
    wall: float | UnsetType | None = UNSET
    error: str | UnsetType | None = UNSET
    command: str | UnsetType = UNSET
    findings: list[_Finding] | UnsetType = UNSET
    ended: _Ended | UnsetType | None = UNSET
    late_clocks: dict[str, Any] | UnsetType = UNSET
    macro_steps: list[dict[str, Any]] | UnsetType = UNSET
    marks: list[dict[str, Any]] | UnsetType = UNSET
    requirements: dict[str, dict[str, Any]] | UnsetType = UNSET
    deployment: dict[str, Any] | UnsetType = UNSET
    rehearsal: dict[str, Any] | UnsetType = UNSET


def check_facts(content: object, place: str) -> None:
    """Refuse a ``run.json`` whose entries have other types. Raises ScenarioError with the entry."""
    try:
        convert(content, _Facts)
    except ValidationError as error:
        text, _, entry = str(error).partition(" - at `$")
        where = f"{place} at {entry.strip('.`')}" if entry else place
        raise ScenarioError(text.replace("`", ""), where) from None
