"""Limits of joints, and numbers of links that are hardly right."""

from __future__ import annotations

from collections.abc import Iterator

from cosim.checks.finding import Finding
from cosim.predict.system import AnalyzedSystem


def start(system: AnalyzedSystem) -> Iterator[Finding]:
    """Joints that start outside of their limits, where no stop would refuse it."""
    for name, arm in system.arms.items():
        for j, (low, high) in enumerate(zip(arm.lower, arm.upper, strict=True)):
            if low <= arm.q[j] <= high:
                continue
            yield Finding(
                rule="limits",
                severity="warning",
                where=f"{name}.{arm.position}[{j}]",
                number=arm.q[j],
                unit="rad",
                reason=f"the joint starts at {arm.q[j]:.4g} rad, outside of its limits {low:.4g} to"
                f" {high:.4g}; no stop acts there",
                advice=f"components.{name}.start.{arm.position} within the limits; k_s and b_s make"
                " stops",
            )


def links(system: AnalyzedSystem) -> Iterator[Finding]:
    """Links whose mass, centre and inertia do not fit the size of the arm."""
    for name, arm in system.arms.items():
        for doubt in arm.doubts:
            yield Finding(
                rule="body",
                severity="warning",
                where=name,
                number=1.0,
                unit="1",
                reason=doubt,
                advice="compare the numbers and their units (kg, m, kg.m2) with those of the maker",
            )
