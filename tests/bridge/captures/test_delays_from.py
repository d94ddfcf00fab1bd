"""``cosim delays from``: what a user sees, also of files that are broken."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin

from cosim.base import extras
from cosim.links.spec import delay_law
from cosim.links.traces import DelayTrace
from tests.bridge.captures import recorded
from tests.bridge.captures.recorded import drifting, no_shift, table
from tests.cli.command import CONFIG, Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture


def test_the_link_is_printed_and_reads_at_once(cosim: Command, tmp_path: Path) -> None:
    known = table()
    recorded.write_mcap(tmp_path / "a.mcap", known)
    done = cosim("delays", "from", "a.mcap", "--json", "a.json")
    assert done.code == 0 and not done.err
    lines = [line.strip() for line in done.out.splitlines()]
    found = tomllib.loads(next(line for line in lines if line.startswith("delay = ")))
    law = delay_law(found["delay"], tmp_path)
    assert isinstance(law, DelayTrace) and law.delay.size == 400
    assert any(line.startswith("tc qdisc add dev DEV root netem delay ") for line in lines)
    data = json.loads((tmp_path / "a.json").read_text())
    assert data["schema"] == "cosim.recording/1" and data["one_clock"]
    link = data["links"]["joint_states"]
    assert link["loss"]["share"] == pytest.approx(known.lost.mean())
    assert link["delay"]["max"] == pytest.approx(np.max(known.delay[~known.lost]) * 1e-9)


def test_several_streams_are_listed(cosim: Command, tmp_path: Path) -> None:
    files = recorded.write_ends(tmp_path, table(1), table(2), no_shift)
    done = cosim("delays", "from", files[0])
    assert done.code == 0
    assert "udp 10.0.0.1:5001 -> 10.0.0.2:5002: 400 samples" in done.out
    assert "no stream has a stamp of sending" in done.out
    recorded.write_bag(tmp_path / "bag", table(), StoragePlugin.SQLITE3)
    done = cosim("delays", "from", "bag")
    assert done.code == 0 and "/silent: the topic has no messages" in done.out


def test_both_ends_with_two_clocks(cosim: Command, tmp_path: Path) -> None:
    files = recorded.write_ends(tmp_path, table(1, 2000), table(2, 2000), drifting(5, 50))
    done = cosim("delays", "from", *files)
    assert done.code == 0
    line = next(x for x in done.out.splitlines() if x.startswith("clock of the receiver: "))
    middle, low, high = (float(x) for x in re.findall(r"[+-]\d\S*", line))
    assert low < 5 < high and middle == pytest.approx(5, abs=1e-3)
    assert {p.name for p in (tmp_path / "delays").iterdir()} == {"there.csv", "back.csv"}


def test_a_prediction_for_a_scenario(cosim: Command, tmp_path: Path) -> None:
    recorded.write_mcap(tmp_path / "a.mcap", table())
    done = cosim(
        "delays", "from", "a.mcap", "--scenario", CONFIG, "--set", "run.stop=5 s"
    )  # fmt: skip
    assert done.code == 0 and "in 99 % of runs" in done.out
    refused = cosim("delays", "from", "a.mcap", "--compare")
    assert refused.code == 2 and "expected --scenario FILE" in refused.err


def _broken(folder: Path) -> dict[str, str]:
    """Files that are none, by name, and what is said of each."""
    known = table(n=50)
    whole = recorded.write_mcap(folder / "whole.mcap", known).read_bytes()
    (folder / "head.mcap").write_bytes(whole[:6])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "no.mcap").write_bytes(b"something else altogether, and long enough")
    (folder / "bag").mkdir()
    (folder / "text.db3").write_text("not a database")
    (folder / "short.pcap").write_bytes(bytes.fromhex("d4c3b2a1") + b"\0" * 8)
    (folder / "no.pcap").write_bytes(b"0123456789")
    (folder / "short.pcapng").write_bytes(bytes.fromhex("0a0d0d0a1c000000"))
    (folder / "no.log").write_text("hello\n")
    (folder / "no.blf").write_bytes(b"LOGG" + b"\0" * 10)
    (folder / "one.csv").write_text("a,b\n1,2\n")
    (folder / "bad.csv").write_text("sent,received\n1,2\n2,x\n3,4\n")
    (folder / "two.csv").write_text("sent,received\n1,2\n2,3\n")
    (folder / "file.xyz").write_text("")
    return {
        "head.mcap": "no message can be read",
        "empty.mcap": "expected an MCAP file",
        "no.mcap": "expected an MCAP file",
        "bag": "no message can be read",
        "text.db3": "expected a bag of ROS",
        "short.pcap": "the header is cut off",
        "no.pcap": "expected pcap or pcapng",
        "short.pcapng": "the first block is cut off",
        "no.log": "expected (seconds) bus id#data",
        "no.blf": "expected a .blf log",
        "one.csv": "expected two stamps",
        "bad.csv": "bad.csv:3: received = 'x'; expected a number",
        "two.csv": "expected at least three",
        "file.xyz": "the suffix '.xyz' is none of a recording",
        "none.mcap": "no such file",
    }


def test_what_is_no_recording_gets_one_sentence(cosim: Command, tmp_path: Path) -> None:
    for name, said in _broken(tmp_path).items():
        done = cosim("delays", "from", name)
        assert done.code == 2, name
        assert said in done.err and done.err.count("\n") == 1 and name in done.err, done.err
        assert not done.out
    assert not (tmp_path / "delays").exists()


@pytest.mark.parametrize("suffix", [".mcap", ".pcap", ".pcapng", ".log"])
def test_a_file_that_is_cut_off_gives_what_it_has(
    cosim: Command, tmp_path: Path, suffix: str
) -> None:
    known = table(n=400, lost=0)
    if suffix == ".mcap":
        path = recorded.write_mcap(tmp_path / "a.mcap", known)
    elif suffix == ".log":
        path = recorded.write_gateway(tmp_path / "a.log", known)
    else:
        path = recorded.write_ends(tmp_path, known, None, no_shift, suffix)[0]
    data = path.read_bytes()
    # within a line of text: behind its first digits, since a shorter frame is one, too
    cut = len(data) // 2 if suffix != ".log" else data.rfind(b"\n", 0, len(data) // 2) + 9
    path.write_bytes(data[:cut])
    done = cosim("delays", "from", path)
    assert done.code == 0 and "is lost" in done.out
    assert "warning: " in done.out


PEAK = """
import sys
from pathlib import Path
from bridge.captures.reading import read_recording
read_recording(sys.argv[1])
status = Path("/proc/self/status").read_text().split()
print(status[status.index("VmHWM:") + 1])
"""


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """80 MB more of a file are 40 000 samples more, 2 MB."""
    peaks = []
    for n in (100, 40_000):
        path = tmp_path / f"{n}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start()
            topic = writer.register_channel("/image", "", 0)
            for i in range(n):
                writer.add_message(topic, i, bytes(2000), i)
            writer.finish()
        call = [sys.executable, "-c", PEAK, str(path)]
        peaks.append(int(subprocess.run(call, check=True, capture_output=True).stdout))
        path.unlink()
    assert peaks[1] - peaks[0] < 25_000  # kB


def test_messages_without_a_known_type_are_named(cosim: Command, tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        odd = writer.register_channel("/odd", "flatbuffer", 0)
        for i in range(20):
            writer.add_message(odd, 10**9 + i * 10**7, b"x", 10**9 + i * 10**7)
        writer.finish()
    done = cosim("delays", "from", "a.mcap")
    assert done.code == 0
    assert "/odd: messages in flatbuffer are not read for stamps" in done.out
    assert "no stream has a stamp of sending" in done.out
    done = cosim("delays", "from", "a.mcap", "--topic", "/odd")
    assert done.code == 2 and "its samples have one stamp" in done.err


@pytest.mark.parametrize("library", ["mcap", "rosbags", "dpkt"])
def test_a_library_that_is_missing_is_named(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "a.pcap").write_bytes(bytes.fromhex("d4c3b2a1"))
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == library else 1)
    name = {"mcap": "a.mcap", "rosbags": "a.bag", "dpkt": "a.pcap"}[library]
    done = cosim("delays", "from", name)
    assert done.code == 2 and library in done.err
    assert "pip install 'cosim-bridge[recordings]'" in done.err


def test_wrong_options_get_one_sentence(cosim: Command, tmp_path: Path) -> None:
    recorded.write_csv(tmp_path / "a.csv", table(n=20))
    for words, said in {
        ("--clocks", "equal"): "expected same, differ, auto",
        ("--stamp", "x"): "expected header, publish, auto",
        ("--least", "5"): "",
        ("--most", "1 m"): "expected [s]",
        ("--least", "2 s", "--most", "1 s"): "expected more than --least",
        ("--period", "0"): "expected more than 0",
        ("--back", "x"): "expected two",
        ("--columns", "x,y"): "--columns SENT,RECEIVED",
    }.items():
        done = cosim("delays", "from", "a.csv", *words)
        assert done.code == (2 if said else 0), words
        assert said in done.err and done.err.count("\n") <= 1


def test_the_list_of_networks_is_as_before(cosim: Command) -> None:
    assert "home network in use" in cosim("delays", "wifi5").out
    assert cosim("delays", "from").code == 2
