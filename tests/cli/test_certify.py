"""The command, from a scenario to a verified file, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cosim.certify.region import region
from cosim.certify.scenario import cut_loop
from cosim.loading.files import load
from tests.cli.command import CONFIG, ROOT, Command

GRIP = ["--set", "components.master.parameters.k_p=100", "--set",
        "components.master.parameters.k_d=10"]  # fmt: skip


def test_the_pair_of_the_paper_is_certified_for_all_delays(cosim: Command, tmp_path: Path) -> None:
    """Theorem 5 states it in continuous time; here with its periods, at rest, with either grip.

    The stiff grip is stable at rest, although one changed entry of a table breaks a large motion.
    """
    pytest.importorskip("clarabel")
    for settings in ([], GRIP):
        done = cosim("check", "--certify", CONFIG, "--out", "proof", *settings)
        assert done.code == 0 and "stable for all delays" in done.out, done.err
        assert "from 0 s up to any" in done.out and "peak gain" in done.out
        again = cosim("check", "--verify", "proof/certificate.json", CONFIG, *settings)
        assert again.code == 0 and "stable for all delays" in again.out
    other = cosim("check", "--verify", "proof/certificate.json", CONFIG)
    assert other.code == 2 and "for the model" in other.err and other.err.count("\n") == 1
    document = json.loads((tmp_path / "proof" / "certificate.json").read_text())
    document["links"][0]["least"] = 1
    (tmp_path / "changed.json").write_text(json.dumps(document))
    refused = cosim("check", "--verify", "changed.json", CONFIG)
    assert refused.code == 2 and "seal" in refused.err


def test_the_example_of_the_page(cosim: Command) -> None:
    pytest.importorskip("clarabel")
    page = (ROOT / "docs" / "certificates.md").read_text(encoding="utf-8")
    example = page.split("<!-- certify -->")[1].split("<!-- end -->")[0].strip().splitlines()[1:-1]
    done = cosim("check", "--certify", CONFIG)
    assert len(example) == 4 and set(example) <= set(done.out.splitlines())


ARM = """
[components.{0}]
model = "fmus.models.planar2r"
start = {{ q = [0.5, 0.9] }}
inputs = {{ tau = "{0}_control.tau" }}
[components.{0}_control]
model = "fmus.models.p_d"
period = "5 ms"
preset = "P+d violating"
inputs = {{ q = "{0}.q", dq = "{0}.dq" }}
[[links]]
from = "{1}.q"
to = "{0}_control.q_j"
delay = {{ law = "uniform", low = "50 ms", high = "200 ms", hold = "30 ms" }}
"""


def test_springs_and_dampers_up_to_their_condition(cosim: Command, tmp_path: Path) -> None:
    """P+d with B = 3 and K = 10: delays up to 0.3 s. The arms send every ms, read every 5 ms."""
    pytest.importorskip("clarabel")
    run = 'title = "P+d"\n[run]\nstep = "1 ms"\nstop = "0.1 s"\n'
    text = run + ARM.format("master", "slave") + ARM.format("slave", "master")
    (tmp_path / "pd.toml").write_text(text, encoding="utf-8")
    done = cosim("check", "--certify", "pd.toml", "--delays", "0,0.29", "--out", "proof")
    assert done.code == 0 and "0 to 0.29 s" in done.out and "small gain" in done.out
    again = cosim("check", "--verify", "proof/certificate.json", "pd.toml")
    assert again.code == 0, again.err
    assert cosim("check", "--certify", "pd.toml", "--delays", "0,0.4").code == 1
    loop, opened = cut_loop(load(tmp_path / "pd.toml"))
    found = region(loop, opened, [0, 40, 56, 68, 80])  # periods of 5 ms
    assert found.highest == (2, 2, 2, -1, -1) and found.unstable == (False,) * 3 + (True,) * 2


FREE = ["--set", "components.master.parameters.k_p=0", "--set",
        "components.master.parameters.k_d=0", "--set", "run.stop=1"]  # fmt: skip


def test_what_is_not_certified_is_unknown(cosim: Command, tmp_path: Path) -> None:
    pytest.importorskip("clarabel")
    done = cosim("check", "--certify", CONFIG, "--delays", "0,30", *FREE)
    assert done.code == 1 and done.out.splitlines()[1].startswith("unknown")
    assert "0 to 30 s" in done.out and not list(tmp_path.iterdir())
    assert "cover large motions of these free robots; the proof needs" in done.out
    assert "not at rest" in done.out and "states still change by up to 1." in done.out
    lossy = [x for i in (0, 1) for x in ("--set", f"links.{i}.semantics=newest-stamp", "--set",
             f"links.{i}.loss.law=independent", "--set", f"links.{i}.loss.p=0.1")]  # fmt: skip
    done = cosim("check", "--certify", CONFIG, *FREE, *lossy)
    assert done.code == 1 and "do not apply: the delays of links" in done.out, done.err


def test_delays_that_break_a_held_pair_are_reported(cosim: Command) -> None:
    """With a slower integral action the network of the scenario may vary so that it grows.

    Theorem 5 does not forbid that: it is about free robots.
    """
    pytest.importorskip("clarabel")
    slow = [x for side in ("master", "slave")
            for x in ("--set", f"components.{side}_control.parameters.lambda_M=1")]  # fmt: skip
    done = cosim("check", "--certify", CONFIG, *slow)
    assert done.code == 1 and done.out.splitlines()[1].startswith("broken")
    assert "do not apply: a hand holds or pushes master" in done.out
    short = cosim("check", "--certify", CONFIG, "--delays", "0,0.2", *slow)
    assert short.code == 0 and "not at rest" not in short.out


def test_a_network_is_certified_for_short_delays(cosim: Command) -> None:
    """Five robots of the network of many, held by a hand: more links than the solver takes."""
    pytest.importorskip("clarabel")
    words = [ROOT / "configs" / "many.toml", "--set", "graphs.net.n=5", "--out", "proof"]
    done = cosim("check", "--certify", *words, "--delays", "0,0.08")
    assert done.code == 0 and "small gain" in done.out, done.err
    again = cosim("check", "--verify", "proof/certificate.json", *words[:3])
    assert again.code == 2 and "does not cover links.control" in again.err


def test_a_map_of_what_is_certified_for_all_delays(cosim: Command, tmp_path: Path) -> None:
    pytest.importorskip("clarabel")
    done = cosim("check", "--certify", CONFIG, "--map", "1.5", "--out", "proof")
    assert done.code == 0 and "certified from 0 s up to 1.5 s; not broken" in done.out
    page = (tmp_path / "proof" / "region.html").read_text(encoding="utf-8")
    assert "0.3 to 1.2 s" in page and page.count("<rect") == 136
    refused = cosim("check", "--certify", CONFIG, "--map", "1.5", "--falsified", "none")
    assert refused.code == 2 and "no failing.toml" in refused.err


def test_the_solver_is_needed_to_certify_only(
    cosim: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.base.extras.find_spec", lambda name: None)
    done = cosim("check", "--certify", CONFIG)
    assert done.code == 2 and "pip install 'cosim-bridge[certify]'" in done.err


@pytest.mark.parametrize("words", [
    ("--certify", "--verify", "x.json"),
    ("--delays", "0,1"),
    ("--out", "x"),
    ("--map", "1"),
    ("--certify", "--falsified", "x"),
    ("--certify", "--json", "x.json"),
    ("--certify", "--delays", "1"),
    ("--certify", "--delays", "2,1"),
    ("--certify", "--delays", "0,inf"),
    ("--certify", "--delays", "a,b"),
    ("--certify", "--delays", "-1,1"),
    ("--certify", "--set", "links.none.delay=3"),
    ("--certify", "--out", CONFIG),
    ("--verify", CONFIG),
    ("--verify", CONFIG.parent),
    ("--verify", "x.json", "--map", "1"),
    ("--verify", "none.json"),
])  # fmt: skip
def test_options_that_do_not_fit_are_refused(cosim: Command, words: tuple[str, ...]) -> None:
    pytest.importorskip("clarabel")
    done = cosim("check", CONFIG, *words)
    assert done.code == 2 and done.err.startswith("error: ") and done.err.count("\n") == 1
