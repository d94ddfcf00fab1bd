"""Settings of a link in a scenario, and the error messages for invalid ones."""

from __future__ import annotations

import tomllib

import pytest

from cosim.base.errors import ScenarioError
from cosim.links.distributions import Gamma, Lognormal
from cosim.links.laws import Constant, Uniform
from cosim.links.losses import GilbertElliott, Independent, Lossy
from cosim.links.markov import Markov
from cosim.links.outages import Outage, RandomOutage
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.storage import StoredTable
from cosim.links.table import DrawnTable
from tests.cosim.links.stored import save_table
from tests.cosim.links.tables import table_of

CONSTANT = 'delay = { law = "constant", delay = 0.1 }\n'


def table(text, folder=None, **changes):
    """The table of a link written in TOML: `delay`, `loss`, `semantics`, `playout`."""
    return table_of(**{"seed": 1, "folder": folder, **tomllib.loads(text), **changes})


@pytest.mark.parametrize(
    "text, law",
    [
        ('delay = { law = "constant", delay = 0.1 }', Constant(0.1)),
        ('delay = { law = "constant", delay = 1 }', Constant(1.0)),
        ('delay = { law = "constant", delay = "100 ms" }', Constant(0.1)),
        (
            'delay = { law = "uniform", low = 0.3, high = 1.2, hold = 0.03 }',
            Uniform(0.3, 1.2, 0.03),
        ),
        (
            'delay = { law = "uniform", low = "300 ms", high = "1.2 s", hold = "30 ms" }',
            Uniform(0.3, 1.2, 0.03),
        ),
        ('delay = { law = "uniform", low = 0, high = 1 }', Uniform(0.0, 1.0, None)),
        (
            'delay = { law = "gamma", shift = "20 ms", shape = 2, scale = "5 ms", maximum = 0.2 }',
            Gamma(0.02, 2.0, 0.005, 0.2),
        ),
        (
            'delay = { law = "lognormal", shift = 0, median = "8 ms", sigma = 0.5, maximum = 1,'
            ' hold = "30 ms" }',
            Lognormal(0.0, 0.008, 0.5, 1.0, 0.03),
        ),
        (
            'delay = { law = "markov", levels = ["50 ms", 0.2], step = "10 ms",'
            " transitions = [[0.5, 0.5], [1, 0]] }",
            Markov((0.05, 0.2), ((0.5, 0.5), (1.0, 0.0)), 0.01),
        ),
        (
            'delay = { law = "markov", levels = [0.1, 0.2], dwell = ["2 s", 0.5], step = 0.01 }',
            Markov.dwelling((0.1, 0.2), (2.0, 0.5), 0.01),
        ),
        (
            'delay = { law = "markov", levels = [0.1, 0.2], dwell = "2 s", step = 0.01 }',
            Markov.dwelling((0.1, 0.2), (2.0,), 0.01),
        ),
    ],
)
def test_laws_are_written_in_seconds_or_with_a_unit(text, law):
    made = table(text)
    assert isinstance(made, DrawnTable)
    assert made.law == law
    assert made == DrawnTable("x", Grid(1, 1, 0.005), law, SignalSemantics(), 1)


@pytest.mark.parametrize(
    "text, model",
    [
        ('{ law = "independent", p = 0.01 }', Independent(0.01)),
        ('{ law = "independent", p = "1 %" }', Independent(0.01)),
        ('{ law = "gilbert-elliott", p = 0.25 }', GilbertElliott(0.25, 0.75, 1.0, 0.0)),
        ('{ law = "gilbert-elliott", p = 0.01, r = "10 %" }', GilbertElliott(0.01, 0.1)),
        (
            '{ law = "gilbert-elliott", p = 0.01, r = 0.1, 1-h = 0.7, 1-k = 0.001 }',
            GilbertElliott(0.01, 0.1, 0.7, 0.001),
        ),
        ('{ law = "outage", length = "300 ms", every = 5 }', Outage(0.3, 5.0, 5.0)),
        ('{ law = "outage", length = 0.3, every = 5, start = 0 }', Outage(0.3, 5.0, 0.0)),
        ('{ law = "outage", length = 0.3, rate = "0.2 Hz" }', RandomOutage(0.3, 0.2)),
    ],
)
def test_a_loss_stands_beside_its_delay(text, model):
    made = table(f'{CONSTANT}loss = {text}\nsemantics = "newest-stamp"')
    assert made.law == Lossy(Constant(0.1), model)
    assert made.facts()["delay"]["loss"] == model.facts()


@pytest.mark.parametrize(
    "text, message",
    [
        ('{ law = "independent", p = 2 }', "p = 2; expected a probability from 0 to less than 1"),
        ('{ law = "independent", p = "1 s" }', r"p = '1 s': \[s\] cannot feed \[1\]"),
        ('{ law = "independent" }', "loss: the key 'p' is missing"),
        ('{ law = "gilbert-elliott", p = 0.1, h = 0.3 }', "loss: .*no key 'h'"),
        ('{ law = "gilbert-elliott", p = 0.1, 1-h = 3 }', "1-h = 3; expected a probability"),
        ('{ law = "rain" }', "loss.law: no kind 'rain'"),
        ('{ law = "outage", length = 1 }', "needs either every .and start. or rate"),
        ('{ law = "outage", length = 1, start = 1 }', "needs either every .and start. or rate"),
        ('{ law = "outage", length = 1, every = 5, rate = 1 }', "needs either every"),
        ('{ law = "outage", length = 1, start = 5, rate = 1 }', "needs either every"),
        ('{ law = "outage", length = 1, every = 1 }', "every = 1 s; expected more than"),
    ],
)
def test_a_loss_that_cannot_be_gets_a_sentence(text, message):
    with pytest.raises(ScenarioError, match=message):
        table(f'{CONSTANT}loss = {text}\nsemantics = "newest-stamp"')


@pytest.mark.parametrize("name", ["signal", "fifo"])
def test_a_loss_contradicts_what_cannot_lose(name):
    text = f'{CONSTANT}loss = {{ law = "independent", p = 0.1 }}\nsemantics = "{name}"'
    with pytest.raises(ScenarioError, match=f'packets are lost, but semantics = "{name}"'):
        table(text)


def test_a_stored_table_takes_no_loss(tmp_path):
    save_table(tmp_path / "t.parquet", table(CONSTANT), 100)
    text = 'delay = { law = "table", file = "t.parquet" }\nloss = { law = "independent", p = 0.1 }'
    with pytest.raises(ScenarioError, match="replays losses as well; expected no key loss"):
        table(text, folder=tmp_path)


def test_a_lossy_table_says_in_its_file_what_it_was_drawn_from(tmp_path):
    made = table(f'{CONSTANT}loss = {{ law = "independent", p = 0.1 }}\nsemantics = "newest-stamp"')
    save_table(tmp_path / "t.parquet", made, 100)
    stored = table('delay = { law = "table", file = "t.parquet" }', folder=tmp_path)
    assert stored.facts()["delay"] == {
        "law": "constant", "delay": 0.1, "loss": {"law": "independent", "p": 0.1},
    }  # fmt: skip
    assert stored.stream(100).rows(100).tolist() == made.stream(100).rows(100).tolist()


@pytest.mark.parametrize("name", ["last-arrival", "newest-stamp", "fifo", "signal"])
def test_semantics_are_named(name):
    made = table(f'delay = {{ law = "constant", delay = 0.1 }}\nsemantics = "{name}"')
    assert made.rule == (SignalSemantics() if name == "signal" else PacketSemantics(name))


def test_playout_has_its_buffer():
    made = table(
        'delay = { law = "constant", delay = 0.1 }\nsemantics = "playout"\nplayout = "1 s"'
    )
    assert made.rule == PlayoutSemantics(1.0)


@pytest.mark.parametrize(
    "text, message",
    [
        ('delay = { law = "constant", delay = -0.1 }', "delay = -0.1 s; expected a delay of 0"),
        ('delay = { law = "constant", delay = nan }', "delay = nan s; expected a delay of 0"),
        ('delay = { law = "constant", delay = "3 m" }', r"delay = '3 m': \[m\] cannot feed \[s\]"),
        ('delay = { law = "constant", delay = "soon" }', "delay = 'soon': 'soon' is not a number"),
        (
            'delay = { law = "constant", delay = true }',
            r"delay.delay: expected a number, found true",
        ),
        ('delay = { law = "constant" }', "delay: the key 'delay' is missing"),
        ('delay = { law = "constant", delay = 1, hold = 1 }', "no key 'hold'"),
        ('delay = { law = "weibull", mean = 1 }', "delay.law: no kind 'weibull'"),
        ("delay = { delay = 1 }", "the key 'law' is missing"),
        ('delay = { law = "uniform", low = 2, high = 1 }', "high = 1 s is less than low = 2 s"),
        ('delay = { law = "uniform", low = 0, high = 1, hold = 0 }', "hold = 0 s; expected a time"),
        (
            'delay = { law = "gamma", shift = 0, shape = "2 s", scale = 1, maximum = 1 }',
            "shape = '2",
        ),
        (
            'delay = { law = "gamma", shift = 1, shape = 2, scale = 1, maximum = 1 }',
            "maximum = 1 s",
        ),
        ('delay = { law = "lognormal", median = 1, sigma = 1 }', "the key 'shift' is missing"),
        ('delay = { law = "markov", levels = [0, 1], step = 1 }', "either transitions or dwell"),
        (
            'delay = { law = "markov", levels = ["1 m"], step = 1, dwell = 1 }',
            r"levels\[0\] = '1 m'",
        ),
        (
            'delay = { law = "markov", levels = [0, 1], step = 1, dwell = 1,'
            " transitions = [[0, 1], [1, 0]] }",
            "either transitions or dwell",
        ),
        ('delay = { law = "trace", file = "none.csv" }', "none.csv: no such file"),
        ('delay = { law = "table", file = "none.parquet" }', "none.parquet: no such file"),
        (CONSTANT + 'semantics = "playout"', "needs the length of its buffer, playout"),
        (CONSTANT + "playout = 1.0", 'playout = 1.0 is a buffer, but semantics = "signal"'),
        (CONSTANT + 'semantics = "playout"\nplayout = -1', "playout = -1 s; expected a time"),
        (CONSTANT + 'semantics = "playout"\nplayout = 0.05', "playout = 0.05 s delivers no sample"),
    ],
)
def test_what_cannot_be_gets_a_sentence(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message):
        table(text, folder=tmp_path)


def test_files_are_relative_to_the_scenario(tmp_path):
    (tmp_path / "wifi.csv").write_text("t_send,delay\n0,0.1\n1,0.3\n")
    made = table('delay = { law = "trace", file = "wifi.csv", repeat = true }', folder=tmp_path)
    assert (made.law.maximum, made.law.repeat) == (0.3, True)


def test_a_stored_table_needs_no_semantics_to_replay(tmp_path):
    drawn = table(CONSTANT)
    save_table(tmp_path / "t.parquet", drawn, 100)
    stored = table('delay = { law = "table", file = "t.parquet" }', folder=tmp_path, name="y")
    assert isinstance(stored, StoredTable)
    assert stored.stream(100).rows(100).tolist() == drawn.stream(100).rows(100).tolist()


def test_a_run_longer_than_its_data_is_refused_at_load(tmp_path):
    (tmp_path / "t.csv").write_text("t_send,delay\n0,0.1\n1,0.3\n")
    trace = 'delay = { law = "trace", file = "t.csv" }'
    save_table(tmp_path / "t.parquet", table(CONSTANT, receiver_period=3), 100)
    stored = 'delay = { law = "table", file = "t.parquet" }'
    table(trace, folder=tmp_path, ticks=400)
    table(stored, folder=tmp_path, receiver_period=3, ticks=300)
    with pytest.raises(ScenarioError, match=r"end after 400 samples.*asks for 401"):
        table(trace, folder=tmp_path, ticks=401)
    with pytest.raises(ScenarioError, match=r"100 rows, the run needs 101"):
        table(stored, folder=tmp_path, receiver_period=3, ticks=301)


def test_periods_and_seeds_that_cannot_be_are_refused():
    with pytest.raises(ScenarioError, match="periods 0, 1 ticks"):
        table(CONSTANT, sender_period=0)
    with pytest.raises(ScenarioError, match="base step 0 s"):
        table(CONSTANT, h=0.0)
    with pytest.raises(ScenarioError, match="seed -1; expected 0 or more"):
        table(CONSTANT, seed=-1)
