"""Comparisons of networks: more than two roles, graphs of links, values of every controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.comparison.comparison import compare
from cosim.comparison.documents import Case, read_base, scenario
from cosim.comparison.variants_file import read
from cosim.scenario.assemble import assemble
from tests.cosim.comparison.parts import CONFIG, ROOT, SMALL, VARIANTS, loaded, written
from tests.tiers import first_fast

RING = ROOT / "configs" / "compare" / "networks" / "ring.toml"
GRAPHS = ROOT / "configs" / "compare" / "networks" / "graphs.toml"
EDGES = {
    "ring": {(4, 1), (1, 2), (2, 3), (3, 4)},
    "tree": {(2, 1), (1, 2), (1, 3), (1, 4)},
    "path": {(1, 2), (2, 1), (2, 3), (3, 2), (3, 4), (4, 3)},
    "fan": {(2, 1), (1, 2), (1, 3), (2, 3), (1, 4), (2, 4), (3, 4)},
}


@pytest.mark.parametrize("graph", EDGES)
def test_who_hears_whom_is_the_graph_of_the_links(graph: str) -> None:
    variants = read(GRAPHS)
    base = read_base(RING, variants)
    plan = assemble(scenario(base, variants, Case("paper", "free", graph, 0)))
    found = {
        (int(x.source.component.removeprefix("control")), int(x.target.component[-1]))
        for x in plan.links
    }
    assert found == EDGES[graph]


def test_a_network_that_is_pushed_moves_further_under_dynamic_than_under_static_feedback() -> None:
    """1 N.m on robot 1: the felt damping of the paper's law is the least; all end together."""
    variants = read(GRAPHS)
    chosen = variants.select(["paper", "abdessameud", "wang"], ["push"], ["ring-constant"])
    base = read_base(RING, variants, ["run.stop=80 s"])
    moved = [o.numbers["moved"][0] for o in compare(base, variants, chosen, (0,)).outcomes]
    assert np.isfinite(moved).all()
    assert moved[0] > 2.0 * max(moved[1:])


def felt_damping(edges: set[tuple[int, int]], mean: bool) -> float:
    """K (1 + T sum_i g_i d_i) / g_1 of static feedback with weights 1, or 1 / neighbours (`mean`).

    It follows from the motion under slow pushes, dq_i = -sum_j w_ij (q_i - q_j(t - T)) + tau_i / K;
    g is the left eigenvector of the Laplacian for the eigenvalue 0, of sum 1; d_i = sum_j w_ij.
    """
    weights = np.zeros((4, 4))
    for sender, receiver in edges:
        weights[receiver - 1, sender - 1] = 1.0
    degree = weights.sum(axis=1)
    if mean:
        weights, degree = weights / degree[:, None], np.ones(4)
    values, vectors = np.linalg.eig((np.diag(degree) - weights).T)
    g = np.real(vectors[:, np.argmin(abs(values))])
    g /= g.sum()
    K, T = 16.0, 0.75
    return float(K * (1.0 + T * g @ degree) / g[0])


@pytest.mark.parametrize("graph", first_fast(["path", "fan"]))
def test_felt_damping_of_static_feedback_follows_from_the_graph(graph: str) -> None:
    variants = read(GRAPHS)
    chosen = variants.select(["wang", "nuno"], ["push"], [graph])
    base = read_base(RING, variants, ["run.stop=100 s"])
    moved = [o.numbers["moved"][0] for o in compare(base, variants, chosen, (0,)).outcomes]
    expected = [60.0 / felt_damping(EDGES[graph], mean) for mean in (False, True)]
    assert moved == pytest.approx(expected, rel=0.01)


def test_an_operator_may_limit_every_controller(tmp_path: Path) -> None:
    text = SMALL + "[operators.weak]\nmaster = { k_p = 10.0 }\ncontrol = { tau_max = 6.5 }\n"
    variants, base = loaded(written(tmp_path, text))
    made = scenario(base, variants, Case("pd", "weak", "constant", 0)).components
    plain = scenario(base, variants, Case("pd", "light", "constant", 0)).components
    for name in ("master_control", "slave_control"):
        assert made[name].parameters["tau_max"] == 6.5
        assert "tau_max" not in plain[name].parameters


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        ('hears = "r4"\n', "", "the key 'hears' is missing"),
        ('hears = "r4"', 'hears = "r1"', "r1 receives from itself; expected another role"),
        ('hears = "r4"', 'hears = "r9"', "no role 'r9'"),
        ('r3 = "r1", ', 'r3 = "r3", ', "at links.tree.hears.r3: r3 receives from itself"),
        ('r3 = ["r2", "r4"]', 'r3 = ["r2", "r3"]', "at links.path.hears.r3: r3 receives from"),
        ('r3 = ["r2", "r4"]', 'r3 = ["r2", "r2"]', "at links.path.hears.r3: r2 twice"),
        ('r3 = ["r2", "r4"]', "r3 = []", "at links.path.hears.r3: empty list"),
        ('r3 = ["r2", "r4"]', 'r3 = ["r2", 4]', "r3[1]: expected text, found"),
        ('r3 = ["r2", "r4"]', 'r3 = ["r2", "r7"]', "at links.path.hears.r3: no role 'r7'"),
        ('r3 = "r1", ', 'x = "r1", ', "at links.tree.hears: no role 'x'"),
    ],
)
def test_what_is_no_graph_is_refused(tmp_path: Path, was: str, now: str, says: str) -> None:
    path = tmp_path / "graphs.toml"
    text = GRAPHS.read_text(encoding="utf-8")
    assert was in text
    path.write_text(text.replace(was, now, 1), encoding="utf-8")
    with pytest.raises(ScenarioError) as error:
        read(path)
    assert says in str(error.value)


@pytest.mark.slow
def test_friction_lets_time_domain_passivity_and_a_stiff_pd_settle() -> None:
    """Nobody at the master, torques within 60 N.m: what the guide says of `real-free`."""
    variants = read(VARIANTS)
    chosen = variants.select(["paper", "tdpa-drift", "pd-stiff"], ["real-free"], ["paper"])
    found = compare(read_base(CONFIG, variants, ["run.stop=60 s"]), variants, chosen, (0,)).outcomes
    paper, tdpa, stiff = found
    assert paper.verdict.stable and paper.numbers["apart"][0] < 1e-3
    assert tdpa.verdict.stable and tdpa.numbers["apart"][0] > 1.0  # nobody gives the line energy
    assert stiff.verdict.stable and stiff.numbers["peak"][0] == 60.0  # at its limit
    assert all(o.numbers["peak"][0] <= 60.0 for o in found)
