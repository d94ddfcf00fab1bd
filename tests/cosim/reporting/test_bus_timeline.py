"""The picture of a simulated bus over time."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from cosim.base.errors import RunError
from cosim.bus.accounting import waits
from cosim.bus.frames import BusFrame
from cosim.bus.settings import BusNodeSettings, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming
from cosim.bus.traffic import PeriodicSource, babbling, merged
from cosim.bus.transmissions import TRANSMISSION, transmissions
from cosim.reporting.bus_timeline import draw_timeline

MS = 10**9
NAMES = ["controller", "drive", "babbler"]


def share_of(path, colour):
    """How many of the picture's pixels have nearly this colour."""
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    return (np.abs(pixels - np.array(colour)).max(axis=2) < 12).mean()


def picture(path, disturbances):
    timing = BusTiming(500e3)
    sources = [PeriodicSource(i, BusFrame(0x100 + i, bytes(8)), MS) for i in range(2)]
    sources.append(babbling(2, BusFrame(0), timing, 4 * MS, 6 * MS))
    rows = merged(sources, 0, 10 * MS)
    bus = SimulatedBus(timing, [BusNodeSettings(n) for n in NAMES], disturbances=disturbances)
    bus.request_many(rows)
    events = bus.advance(10 * MS)
    busy = transmissions(events, timing, 10 * MS)
    labels = {i: f"{r['frame']['id']:X}" for i, r in enumerate(rows)}
    waiting = waits(rows, events)
    return draw_timeline(path, busy, NAMES, 0, 10 * MS, labels=labels, waiting=waiting)


def test_errors_are_seen_in_the_picture(tmp_path):
    clean = picture(tmp_path / "clean.png", [])
    errors = [ScriptedError(0x100, 60, attempt) for attempt in range(1, 7)]
    disturbed = picture(tmp_path / "disturbed.png", errors)
    orange, blue, grey = (0xD5, 0x5E, 0), (0, 0x72, 0xB2), (217, 217, 217)
    assert share_of(clean, orange) == 0
    assert share_of(disturbed, orange) > 0.001
    assert share_of(clean, blue) > 0.05
    assert share_of(clean, grey) > 0.001


def test_the_same_run_gives_the_same_picture(tmp_path):
    assert (
        picture(tmp_path / "a.png", []).read_bytes() == picture(tmp_path / "b.png", []).read_bytes()
    )


def test_too_much_for_one_picture_is_refused(tmp_path):
    many = np.zeros(5001, TRANSMISSION)
    many["start"] = np.arange(5001)
    many["end"] = many["start"] + 1
    with pytest.raises(RunError, match=r"found 5001 transmissions in .* at most 5000"):
        draw_timeline(tmp_path / "x.png", many, NAMES, 0, 10**12)
