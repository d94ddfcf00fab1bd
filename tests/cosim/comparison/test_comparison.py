"""Small comparisons through the real FMUs: the numbers, the same links for all, and failures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.comparison.comparison import Comparison, compare
from cosim.comparison.documents import check, read_base
from cosim.comparison.measure import CaseOutcome
from cosim.comparison.rows import rows
from cosim.comparison.same_links import Tables
from cosim.links import storage
from cosim.links.storage import load_table
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.ssp.export import write
from tests.cosim.comparison.parts import (
    SMALL,
    VARIANTS,
    compared,
    loaded,
    push,
    stored,
    written,
)

#: t(|q_1 - q_h| < 0.05), s, and ‖τ_h‖₂, N.m.√s, of an independent simulation whose delays come
#: from another generator: operator 10/5, T = 0.3 + U[0, 0.9] s redrawn every 30 ms.
SIDE_BY_SIDE = {
    "paper": (9.3, 47.0), "paper-1": (18.7, 84.0), "pd": (10.5, 52.0), "p+d": (24.2, 74.0),
    "lee-spong": (23.4, 74.0), "nuno": (30.9, 95.0), "chopra": (20.0, 61.0),
    "wang": (31.0, 94.0), "wave": (43.0, 65.0),
}  # fmt: skip


def one(comparison: Comparison, controller: str, operator: str, link: str = "paper") -> CaseOutcome:
    (outcome,) = comparison.of(link, operator, controller)
    return outcome


def number(outcome: CaseOutcome, column: str) -> float:
    return outcome.numbers[column][0]


@pytest.fixture(scope="module")
def small() -> Comparison:
    """Controllers that send different things, a light and a tight hand, the paper's delay."""
    return compared(
        VARIANTS, ["paper", "paper-1", "pd", "chopra", "wave"], ["light", "tight"], ["paper"],
        settings=["run.stop=60 s"],
    )  # fmt: skip


# ---- numbers -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper", "paper-1", "pd", "chopra", "wave"])
def test_numbers_are_those_of_an_independent_simulation(small: Comparison, name: str) -> None:
    outcome = one(small, name, "light")
    reach, effort = SIDE_BY_SIDE[name]
    assert number(outcome, "reach") == pytest.approx(reach, rel=0.1)
    assert number(outcome, "effort") == pytest.approx(effort, rel=0.1)


@pytest.mark.slow
def test_the_whole_table_of_an_independent_simulation() -> None:
    found = compared(VARIANTS, list(SIDE_BY_SIDE), ["light"], ["paper"])
    for name, (reach, effort) in SIDE_BY_SIDE.items():
        outcome = one(found, name, "light")
        assert number(outcome, "reach") == pytest.approx(reach, rel=0.1), name
        assert number(outcome, "effort") == pytest.approx(effort, rel=0.1), name
    assert number(one(found, "wave", "light"), "apart") == pytest.approx(3.3, rel=0.2)


@pytest.mark.slow
def test_conditions_that_hold_and_do_not_with_nobody_at_the_master() -> None:
    met = {"paper": 7.9, "p+d": 3.5, "lee-spong": 2.6, "nuno": 1.7, "wang": 3.4, "chopra": 72.0}
    found = compared(VARIANTS, [*met, "pd", "pd-stiff", "p+d-violating"], ["free"], ["constant"])
    for name, expected in met.items():
        outcome = one(found, name, "free", "constant")
        assert outcome.verdict.stable, name
        assert number(outcome, "synchronised") == pytest.approx(expected, rel=0.1), name
    assert one(found, "pd", "free", "constant").verdict.kind == "moving"
    assert one(found, "pd", "free", "constant").verdict.speed == pytest.approx(6.0, rel=0.1)
    for name in ("pd-stiff", "p+d-violating"):
        assert one(found, name, "free", "constant").verdict.kind == "diverged", name


@pytest.mark.slow
def test_a_wall_is_felt_as_springs_in_series() -> None:
    """τ = (q_h - q_w) / (1/k_p + 1/κ + 1/k_w) of each joint, κ = λ α K / λ_M."""
    found = compared(VARIANTS, ["paper", "paper-1"], ["wall"], ["paper"])
    for name, stiffness in (("paper", 1.6), ("paper-1", 16.0)):
        felt = np.linalg.norm([2.5, 2.0]) / (1 / 10 + 1 / stiffness + 1 / 200)
        assert number(one(found, name, "wall"), "holding") == pytest.approx(felt, rel=1e-3)
        assert number(one(found, name, "wall"), "reflection") < 1e-3


def test_a_tight_grip_destabilises_dynamic_feedback_with_a_large_gain(small: Comparison) -> None:
    lost = one(small, "paper", "tight")
    assert (lost.verdict.kind, lost.verdict.stable) == ("diverged", False)
    assert lost.verdict.time == pytest.approx(0.18, abs=0.02)
    assert "motion left the range" in lost.verdict.reason
    for name in ("paper-1", "pd", "chopra", "wave"):
        assert one(small, name, "tight").verdict.stable, name


def test_a_run_that_diverged_is_a_row_without_numbers(small: Comparison) -> None:
    found = {(row.operator, row.controller): row for row in rows(small)}
    assert len(found) == 10
    row = found["tight", "paper"]
    assert [row.cell(c, "s") for c in small.variants.columns[:3]] == ["–", "–", "–"]
    assert row.stable == "no: diverged at 0.17 s"
    assert found["light", "paper"].stable == "yes"


# ---- the same links ----------------------------------------------------------------------------


def test_every_controller_ran_over_the_same_tables(small: Comparison) -> None:
    """xi, q and dq, r, and waves: all of them held the same samples at the same looks."""
    assert small.tables.same
    channels = small.tables.channels
    assert set(channels) == {("paper", 0, "master->slave"), ("paper", 0, "slave->master")}
    assert all(c.runs == 10 for c in channels.values())
    assert {c.table.rows for c in channels.values()} == {12000}
    there, back = (channels[key].table for key in sorted(channels))
    assert there.digest != back.digest
    assert small.tables.varies("paper")
    assert small.tables.sentences(["paper"])[0].startswith("paper: 2 tables in 20 uses, seed 0")


def test_only_laws_that_need_a_constant_delay_are_marked(small: Comparison) -> None:
    marked = {row.controller for row in rows(small) if row.marked}
    assert marked == {"chopra", "wave"}
    constant = compared(VARIANTS, ["chopra"], ["light"], ["constant"], settings=["run.stop=2 s"])
    assert not any(row.marked for row in rows(constant))


def test_a_saved_table_replays_the_run(small: Comparison, tmp_path: Path) -> None:
    small.tables.save(tmp_path)
    files = {p.stem: p for p in (tmp_path / "paper-seed0").glob("*.parquet")}
    assert set(files) == {"master-%3Eslave", "slave-%3Emaster"}
    facts, held = load_table(files["master-%3Eslave"])
    assert facts["name"] == "master->slave"
    text = VARIANTS.read_text(encoding="utf-8")
    law = f'{{ law = "table", file = "{files["master-%3Eslave"]}" }}'
    replay = text.replace("[links.lan]", f"[links.replay]\ndelay = {law}\n[links.lan]", 1)
    replayed = compared(
        written(tmp_path, replay), ["pd"], ["light"], ["replay"], settings=["run.stop=2 s"]
    )
    _, again = load_table(replayed.tables.channels["replay", 0, "master->slave"].table.path)
    assert np.array_equal(again, held[: len(again)])
    assert len(again) == 400


def test_another_period_of_sending_is_noticed() -> None:
    """With arms at 1 ms a controller that sends what the arm measures sends five times as often."""
    found = compared(
        VARIANTS, ["chopra", "p+d"], ["light"], ["newest"],
        settings=["run.step=1 ms", "run.stop=1 s"],
    )  # fmt: skip
    assert not found.tables.same
    said = "\n".join(found.tables.sentences(["newest"]))
    assert "NOT the same tables" in said
    assert "master->slave: p+d sends every 0.001 s, chopra every 0.005 s" in said


@pytest.mark.parametrize("group", [1 << 18, 8])
def test_rows_that_differ_are_noticed(
    small: Comparison, tmp_path: Path, group: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "GROUP", group)
    case = small.outcomes[0].case
    rows_ = list(range(100))
    facts = {"name": "a->b", "sender_period": 1, "receiver_period": 1, "h": 0.005}
    tables = Tables()
    tables.add(case, [stored(tmp_path, facts, rows_)])
    tables.add(case, [stored(tmp_path, facts, rows_[:43])])  # a run that ended early
    assert tables.same
    tables.add(case, [stored(tmp_path, facts, [*rows_[:17], 3, *rows_[18:]])])
    assert tables.differences == [
        f"paper, seed 0, a->b: {case.controller} and {case.controller} differ from look 17 on"
    ]


def test_seeds_are_other_delays_and_the_same_for_all() -> None:
    found = compared(
        VARIANTS, ["paper", "pd"], ["light"], ["paper"], seeds=(0, 1), settings=["run.stop=12 s"]
    )
    assert found.tables.same
    first, second = (found.tables.channels["paper", s, "master->slave"] for s in (0, 1))
    assert first.table.digest != second.table.digest
    row = next(iter(rows(found)))
    assert [o.case.seed for o in row.outcomes] == [0, 1]
    effort = next(c for c in found.variants.columns if c.name == "effort")
    low, high = sorted(row.values(effort))
    middle = (low + high) / 2
    assert row.cell(effort, "N.m") == f"{middle:.3g} [{low:.3g}, {high:.3g}]"


# ---- failures are rows -------------------------------------------------------------------------


def test_what_fails_is_a_row_with_its_reason(tmp_path: Path) -> None:
    text = SMALL + push("pushes") + push("fails", fail_at=0.5) + push("refuses", refuse=True)
    found = compared(written(tmp_path, text))
    kinds = {o.case.controller: o.verdict.kind for o in found.outcomes}
    assert kinds["fails"] == kinds["refuses"] == "stopped"
    assert kinds["pushes"] not in ("stopped", "diverged")
    fails, refuses = (one(found, name, "light", "constant") for name in ("fails", "refuses"))
    assert fails.verdict.time == pytest.approx(0.5)
    assert "ArithmeticError: no torque left (parts.py, line" in fails.verdict.reason
    assert "will not start" in refuses.verdict.reason
    assert [len(c.t) for c in fails.curves] == [101, 101]  # until then there is a trajectory
    assert number(one(found, "pd", "light", "constant"), "effort") > 0


def test_a_crash_is_a_row_too_and_jobs_change_nothing(tmp_path: Path) -> None:
    text = SMALL + push("crashes", fail_at=0.5, crash=True)
    found = compared(written(tmp_path, text), jobs=2)
    assert one(found, "crashes", "light", "constant").verdict.reason.startswith(
        "the worker process died"
    )
    here = compared(written(tmp_path, text), ["pd"])
    assert one(found, "pd", "light", "constant").numbers == one(
        here, "pd", "light", "constant"
    ).numbers  # fmt: skip


def test_a_column_that_cannot_be_evaluated_is_a_reason(tmp_path: Path) -> None:
    text = SMALL.replace('kind = "norm"', 'kind = "error"\ntarget = [1.0, 2.0, 3.0]')
    (outcome,) = compared(written(tmp_path, text)).outcomes
    assert "master.tau_h has size 2" in outcome.verdict.reason


def test_the_scenario_may_be_a_system_of_another_tool(tmp_path: Path) -> None:
    """What is compared over an exported scenario is what is compared over the scenario."""
    path = written(tmp_path, SMALL)
    variants, base = loaded(path)
    read = build(base.document, base.path)
    write(read, assemble(read), tmp_path / "arms.ssp")
    again = read_base(tmp_path / "arms.ssp", variants)
    chosen = variants.select((), (), ())
    check(again, variants, chosen)
    found, expected = (compare(b, variants, chosen, (0,), jobs=1) for b in (again, base))
    assert [o.numbers for o in found.outcomes] == [o.numbers for o in expected.outcomes]
