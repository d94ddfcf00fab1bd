"""In lock-step, what waits to be sent travels as one payload a message."""

from pathlib import Path
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from bridge.native.frame import Frame
from bridge.zenoh import batches
from bridge.zenoh.channel import ROOM
from tests.bridge.can.bus_contract import collect, keys, numbers
from tests.bridge.zenoh.ends import both, endpoint, key
from tests.bridge.zenoh.test_channel import until


def message(data: bytes, encoding: object = batches.ENCODING) -> SimpleNamespace:
    return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data), encoding=encoding)


@given(samples=st.lists(st.binary(max_size=300), max_size=20))
def test_samples_come_out_as_they_went_in(samples: list[bytes]):
    data = batches.joined(samples)
    assert batches.samples_of(message(data)) == samples  # type: ignore[arg-type]
    alone = batches.samples_of(message(data, "another"))  # type: ignore[arg-type]
    assert list(alone) == [data]


def test_what_waits_is_one_payload_a_message(tmp_path: Path):
    ours, theirs = both(endpoint(tmp_path), lockstep=True)
    puts: list[int] = []
    inner = ours._put_payload
    ours._put_payload = lambda n, *rest: (puts.append(n), inner(n, *rest))  # type: ignore
    frames = [Frame.of(0x100 + k % 2, bytes([k])) for k in range(100)]
    for frame in frames:
        ours._tx.put(frame)  # the thread is not woken yet
    ours._wake.set()
    found = collect(theirs.bus, 100)
    for number in (0x100, 0x101):
        sent = [frame for frame in frames if frame.id == number]
        assert keys([f for f in found if f.id == number]) == keys(sent)
    assert puts == [0x100, 0x101]
    ours.close()
    theirs.close()


def test_what_there_is_no_room_for_waits_and_is_not_lost(tmp_path: Path):
    ours, theirs = both(endpoint(tmp_path), lockstep=True)
    many = 3 * 8192
    payload = batches.joined([k.to_bytes(4, "little") for k in range(many)])
    ours.session.put(key("a", 0x100), payload, encoding=batches.ENCODING)
    until(lambda: len(theirs._rx) >= 8192 - ROOM)
    found = numbers(collect(theirs.bus, many))
    assert found == list(range(many))
    assert theirs.health(0).overruns == 0
    ours.close()
    theirs.close()
