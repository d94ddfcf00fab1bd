"""A campaign of many faults: what is drawn, what its runs come to, and its table."""

from __future__ import annotations

import subprocess
from collections import Counter
from itertools import permutations

import pytest

from bridge.campaign import driver
from bridge.campaign import table as campaign_table
from bridge.campaign.drive_draw import drives_of
from bridge.campaign.driver import CampaignSetup
from bridge.campaign.plan import document, load_many
from bridge.campaign.table import failures
from bridge.deployment.system import load_system
from bridge.faults.load import SPECS, build
from bridge.rehearsal import hosts
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.study.runner import Observer
from tests.bridge.rehearsing import COSIM, ROOT, SCENARIO, environment

FILE = ROOT / "configs" / "faults" / "many.toml"
#: Need a CAN bus of a kernel: `cosim campaign configs/faults/campaign.toml`.
OF_KERNEL = {"bus-down", "babble"}
OF_PROCESSES = {"restart", "freeze", "clock-jump", "kill"}


@pytest.fixture(scope="module")
def many():
    return load_many(FILE)


@pytest.fixture(scope="module")
def systems(many):
    return {
        channel: load_system(SCENARIO, str(many.deployment(channel)), many.changes(channel, True))
        for channel in many.spec.channels
    }


def drawn(many, systems, seed, k):
    channel, rehearsed = many.kind_of_run(k)
    system = systems[channel]
    links = [f"{a}>{b}" for a, b in permutations(hosts.groups(system), 2)]
    return channel, rehearsed, document(many, system, links, rehearsed, seed, k)


def test_every_kind_meets_every_channel_that_has_it(many, systems):
    found, rehearsals = Counter(), Counter()
    for k in range(300):
        channel, rehearsed, made = drawn(many, systems, 1, k)
        rehearsals[channel] += rehearsed
        script = build(made, FILE)
        assert script.events == () or rehearsed
        found.update((t["kind"], channel) for t in made["fault"])
    for channel in many.spec.channels:
        kinds = {kind for kind, place in found if place == channel}
        without = OF_KERNEL | (
            {k for k in SPECS if k.startswith("net-")} if channel == "can" else set()
        )
        without |= {"sync-loss"} if channel == "zenoh" else set()
        if not many.spec.channels[channel].rehearsals:  # simulated runs have no faults of processes
            without |= {kind for kind in SPECS if not found[kind, "can"] or kind in OF_PROCESSES}
        without |= set() if drives_of(systems[channel]) else {"drive"}
        without |= {"noise"}  # needs an image
        assert kinds == set(SPECS) - without
        assert rehearsals[channel] >= 12 * bool(many.spec.channels[channel].rehearsals)


def test_what_is_drawn_depends_on_the_seed_and_the_run_only(many, systems):
    first = [drawn(many, systems, 3, k) for k in range(12)]
    assert first == [drawn(many, systems, 3, k) for k in range(12)]
    assert all(a[2] != drawn(many, systems, 4, k)[2] for k, a in enumerate(first))


def test_who_is_killed_is_not_who_begins_again(many, systems):
    for k in range(120):
        _, _, made = drawn(many, systems, 5, k)
        whom = [t["node"] for t in made["fault"] if t["kind"] in ("kill", "restart")]
        assert len(whom) == len(set(whom))
        others = {t.get("node") for t in made["fault"] if t["kind"] == "corrupt"}
        assert not others & set(whom)  # counters die with them


def test_a_loss_of_sync_is_drawn_only_where_sync_is_heard(many, systems):
    for k in range(60):
        channel, _, made = drawn(many, systems, 6, k)
        system = systems[channel]
        for table in (t for t in made["fault"] if t["kind"] == "sync-loss"):
            sender = system.deployment.sync
            assert sender and set(system.buses_of(table["node"])) & set(system.buses_of(sender))


def test_faults_of_the_network_come_before_a_node_is_away(many, systems):
    for k in range(60):
        _, _, made = drawn(many, systems, 7, k)
        over = [t["at"] + t["for"] for t in made["fault"] if t["kind"].startswith("net-")]
        away = [t["at"] for t in made["fault"] if t["kind"] in ("restart", "kill")]
        assert not over or not away or max(over) <= min(away)


def test_simulated_runs_pass_and_are_not_made_again(many, tmp_path):
    job = CampaignSetup(many, tmp_path, seed=1, hosted=False)
    calm = {k: v for k, v in many.kinds.items() if k not in ("absurd", "forge", "flood", "replay")}
    job = replace(job, many=_with(many, kinds=calm))
    records = driver.campaign(job, 20, 1)
    assert failures(records) == []
    table = {row[0]: row[-2] for row in campaign_table.kinds(records)}
    injected, seen, idle, unseen = map(int, table["all"].split(" / "))
    assert injected >= 20 and seen + idle == injected and seen > 0 and unseen == 0
    begun = []
    again = driver.campaign(job, 20, 1, observer=Observer(begun=begun.append))
    assert begun[0].to_run == 0 and len(again) == len(records)
    assert "| drop |" in campaign_table.markdown(records, "Title")
    with pytest.raises(ScenarioError, match="was started with another seed"):
        driver.campaign(replace(job, seed=2), 20, 1)


def test_a_folder_with_other_files_is_not_taken_for_a_campaign(many, tmp_path):
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(ScenarioError, match=r"holds mine\.txt but no campaign"):
        driver.campaign(CampaignSetup(many, tmp_path, seed=1, hosted=False), 1, 1)


def test_without_the_checks_of_receivers_a_campaign_fails(many, tmp_path):
    job = CampaignSetup(many, tmp_path, seed=1, hosted=False, blind=True)
    wrong = failures(driver.campaign(job, 40, 1))
    assert any("corrupted frames accepted" in line for line in wrong)


def test_a_file_that_cannot_be_is_refused(tmp_path):
    path = tmp_path / "many.toml"
    path.write_text(
        'scenario = "x.toml"\nrun = "1 s"\ntorque_max = 1\n[channels.a]\ndeploy = "a"\n'
    )
    with pytest.raises(ScenarioError, match="kinds"):
        load_many(path)
    path.write_text(path.read_text() + "[kinds.drop]\nfor = 1\n")
    with pytest.raises(ScenarioError, match=r"is 1 s; expected 7 s or more"):
        load_many(path)


def _with(many, **changes):
    from msgspec import structs

    return structs.replace(many, **changes)


@pytest.mark.slow
def test_a_campaign_with_processes(tmp_path):
    if why := hosts.missing():
        pytest.skip(f"no hosts here: {why}")
    words = ["campaign", FILE, "--faults", "60", "--seed", "3", "--out", tmp_path / "many"]
    done = subprocess.run(
        [*COSIM, *map(str, words)],
        capture_output=True, text=True, cwd=ROOT, env=environment(), timeout=400,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| all |" in (tmp_path / "many" / "summary.md").read_text()
