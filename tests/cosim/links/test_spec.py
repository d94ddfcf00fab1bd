"""What a scenario may say about a link, and the sentences it gets back."""

from __future__ import annotations

import tomllib

import msgspec
import pytest

from cosim.errors import ScenarioError
from cosim.links.grid import Grid
from cosim.links.laws import Constant, Uniform
from cosim.links.semantics import Packets, Playout, Signal
from cosim.links.spec import ConstantDelay, DelaySpec, link_table
from cosim.links.storage import StoredTable, save_table
from cosim.links.table import DrawnTable

PLACE = "s.toml at links.0"
CONSTANT = 'delay = { law = "constant", delay = 0.1 }\n'


def table(text, folder=None, **changes):
    """The table of a link written in TOML: `delay`, `semantics`, `playout`."""
    link = {"semantics": "signal", "playout": None, **tomllib.loads(text)}
    given = {
        "name": "x", "seed": 1, "h": 0.005, "sender_period": 1, "receiver_period": 1,
        "folder": folder, "place": PLACE,
    }  # fmt: skip
    return link_table(**{**link, **given, **changes})


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
    ],
)
def test_laws_are_written_in_seconds_or_with_a_unit(text, law):
    made = table(text)
    assert isinstance(made, DrawnTable)
    assert made.law == law
    assert made == DrawnTable("x", Grid(1, 1, 0.005), law, Signal(), 1)


@pytest.mark.parametrize("name", ["last-arrival", "newest-stamp", "fifo", "signal"])
def test_semantics_are_named(name):
    made = table(f'delay = {{ law = "constant", delay = 0.1 }}\nsemantics = "{name}"')
    assert made.rule == (Signal() if name == "signal" else Packets(name))


def test_playout_has_its_buffer():
    made = table(
        'delay = { law = "constant", delay = 0.1 }\nsemantics = "playout"\nplayout = "1 s"'
    )
    assert made.rule == Playout(1.0)


@pytest.mark.parametrize(
    "text, message",
    [
        ('delay = { law = "constant", delay = -0.1 }', "delay = -0.1 s; expected a delay of 0"),
        ('delay = { law = "constant", delay = nan }', "delay = nan s; expected a delay of 0"),
        ('delay = { law = "constant", delay = "3 m" }', r"delay = '3 m': \[m\] cannot feed \[s\]"),
        ('delay = { law = "constant", delay = "soon" }', "delay = 'soon': 'soon' is not a number"),
        ('delay = { law = "constant", delay = true }', r"delay.delay: Expected `int \| float"),
        ('delay = { law = "constant" }', "delay: Object missing required field `delay`"),
        ('delay = { law = "constant", delay = 1, hold = 1 }', "unknown field `hold`"),
        ('delay = { law = "normal", mean = 1 }', "delay.law: Invalid value 'normal'"),
        ("delay = { delay = 1 }", "missing required field `law`"),
        ('delay = { law = "uniform", low = 2, high = 1 }', "high = 1 s is less than low = 2 s"),
        ('delay = { law = "uniform", low = 0, high = 1, hold = 0 }', "hold = 0 s; expected a time"),
        ('delay = { law = "trace", file = "none.csv" }', "none.csv: no such file"),
        ('delay = { law = "table", file = "none.parquet" }', "none.parquet: no such file"),
        (CONSTANT + 'semantics = "playout"', "needs the length of its buffer, playout"),
        (CONSTANT + "playout = 1.0", 'playout = 1.0 is a buffer, but semantics = "signal"'),
        (CONSTANT + 'semantics = "playout"\nplayout = -1', "playout = -1 s; expected a time"),
        (CONSTANT + 'semantics = "playout"\nplayout = 0.05', "playout = 0.05 s never plays"),
    ],
)
def test_what_cannot_be_gets_a_sentence_and_its_place(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        table(text, folder=tmp_path)
    assert str(caught.value).startswith(PLACE)
    assert caught.value.place == PLACE


def test_delays_decode_inside_a_larger_struct():
    text = b'{"law": "constant", "delay": "5 ms"}'
    assert msgspec.json.decode(text, type=DelaySpec) == ConstantDelay("5 ms")
    assert table("", delay=ConstantDelay("5 ms")).law == Constant(0.005)


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
    with pytest.raises(ScenarioError, match=r"links.0: .*end after 400 samples.*asks for 401"):
        table(trace, folder=tmp_path, ticks=401)
    with pytest.raises(ScenarioError, match=r"links.0: .*100 rows, the run asks for 101"):
        table(stored, folder=tmp_path, receiver_period=3, ticks=301)


def test_periods_and_seeds_that_cannot_be_are_refused():
    with pytest.raises(ScenarioError, match="periods 0, 1 ticks"):
        table(CONSTANT, sender_period=0)
    with pytest.raises(ScenarioError, match="base step 0 s"):
        table(CONSTANT, h=0.0)
    with pytest.raises(ScenarioError, match="seed -1; expected 0 or more"):
        table(CONSTANT, seed=-1)
