"""The law "zenoh-can" in scenarios: bounds, repetition, and what is refused."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.links.spec import delay_law

PAGE = Path(__file__).parents[3] / "docs/bus.md"
RATES = {"law": "zenoh-can", "bitrate": 1e6, "data_bitrate": 5e6, "payload": 89}
FLOOD = {"identifier": 0x100, "bytes": 64, "period": "1 ms"}


def law(**keys: Any) -> Any:
    """The law with these keys."""
    return delay_law({**RATES, **keys}, Path())


def drawn(found: Any, seed: int, count: int = 50) -> np.ndarray:
    """Delays at 100 Hz, s."""
    return found.stream(Fraction(1, 100), np.random.default_rng(seed)).take(count)


@pytest.mark.parametrize("keys", [{}, {"link": "isotp"}, {"traffic": [FLOOD]}])
def test_delays_are_within_the_declared_bounds_and_repeat(keys: dict[str, Any]) -> None:
    found = law(**keys)
    a, b = drawn(found, 1), drawn(found, 1)
    assert a.tobytes() == b.tobytes() != drawn(found, 2).tobytes()
    assert found.minimum <= a.min() and a.max() <= found.maximum
    assert found.minimum < found.mean < found.maximum and not found.loses_packets
    parts = found.stream(Fraction(1, 100), np.random.default_rng(1))
    assert np.concatenate([parts.take(n) for n in (1, 30, 19)]).tobytes() == a.tobytes()


def test_the_frames_are_facts_of_the_run() -> None:
    assert law().facts()["frames"] == [64, 46]  # padded to 64 and 48 on the bus
    assert law(link="isotp").facts()["frames"] == [64, 48]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"payload": "many"}, "payload"),
        ({"payload": -1}, "negative number of bytes"),
        ({"link": "isotp", "payload": 5000}, "expected 1 to 4095"),
        ({"traffic": [FLOOD | {"period": 0}]}, "period of traffic that is not above 0"),
        ({"traffic": [FLOOD | {"period": "100 us"}]}, "overloaded bus"),
        ({"traffic": [FLOOD | {"identifier": 0x400}]}, "one identifier in two messages"),
        ({"traffic": [FLOOD | {"bytes": 65}]}, "65 bytes"),
        ({"stmin": "-1 ms"}, "below 0"),
        ({"bitrate": 0}, "bit rate"),
        ({"identifier": 0x800}, "expected 11 bits"),
        ({"link": "tcp"}, "link"),
        ({"stminn": 1}, "stminn"),
    ],
)
def test_keys_that_cannot_be_are_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        drawn(law(**keys), 1)


def rows_of_the_page() -> list[list[str]]:
    """The cells of the table of the page on buses."""
    text = PAGE.read_text(encoding="utf-8").partition("<!-- zenoh-can -->")[2]
    lines = text.partition("<!-- end -->")[0].strip().splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.parametrize("row", rows_of_the_page(), ids=lambda row: f"{row[1]} {row[0]}")
def test_the_table_of_the_page_is_computed(row: list[str]) -> None:
    keys = {"payload": int(row[0]), "link": row[1]}
    found, flooded = law(**keys), law(**keys, traffic=[FLOOD | {"period": "300 us"}])
    delays = found.stream(Fraction(1, 20), np.random.default_rng(1)).take(200)
    assert row[2:] == [
        str(len(found.transfer.lengths)),
        f"{found.minimum * 1e3:.2f} to {found.maximum * 1e3:.2f}",
        f"{delays.min() * 1e3:.2f} to {delays.max() * 1e3:.2f}",
        f"{flooded.maximum * 1e3:.2f}",
    ]


def test_messages_that_would_wait_for_each_other_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"a message every 0\.0001 s, which can take"):
        law().stream(Fraction(1, 10000), np.random.default_rng(0))
