"""Every fuzz target for a bounded number of mutants of a fixed seed; and findings are found."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.fuzz import drive, sanitized
from tests.fuzz.mutate import of_archive, of_bytes, of_text, packed, unpacked
from tests.fuzz.targets import ROOT, TARGETS, Target
from tests.tiers import first_fast

numpy = pytest.importorskip("numpy")
#: Mutants of each target; readers of archives and TOML are slower than those of bytes.
COUNTS = {"journal": 200, "faults": 60, "buslog": 30, "decode": 100, "hear": 60}
#: Targets of the fast tests; those in C are compiled with sanitizers first, which takes longer.
FAST = ("journal", "faults", "deployment")
NAMES = first_fast([*FAST, *(name for name in drive.names() if name not in FAST)], len(FAST))


@pytest.mark.parametrize("name", NAMES)
def test_mutants_are_refused_with_one_sentence(name):
    """In a process of its own, whose memory is limited, and which a crash may end."""
    why = sanitized.missing() if name in sanitized.TARGETS else ""
    if why:
        pytest.skip(why)
    count = COUNTS.get(name, 10)
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", name, "--count", str(count), "--seed", "1"],
        capture_output=True, text=True, cwd=ROOT, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    tried = int(done.stdout.split()[1])
    assert tried >= count


def test_what_is_no_cosim_error_is_a_finding(monkeypatch):
    def read(path):
        if b"\n\n" not in path.read_bytes():
            raise KeyError("no empty line")

    broken = Target("faults", read, of_text, (".toml",))
    monkeypatch.setitem(TARGETS, "faults", broken)
    found = drive.fuzz("faults", seed=1, count=200).findings
    assert found and "KeyError" in found[0].what
    assert b"\n\n" not in found[0].data


def test_an_input_that_is_no_mutant_is_tried_as_well(monkeypatch):
    def read(path):
        raise KeyError(path)

    monkeypatch.setitem(TARGETS, "faults", Target("faults", read, of_text, (".toml",)))
    assert len(drive.fuzz("faults", seed=1, count=0).findings) == 1


def test_a_reader_that_hangs_is_a_finding(monkeypatch):
    def read(path):
        while True:
            pass

    monkeypatch.setattr(drive, "HANG", 0.05)
    monkeypatch.setitem(TARGETS, "faults", Target("faults", read, of_text, (".toml",)))
    assert "Hang" in drive.fuzz("faults", seed=1, count=1).findings[0].what


@pytest.mark.parametrize("mutate", [of_bytes, of_text, of_archive])
def test_the_same_seed_makes_the_same_mutants(mutate):
    data = packed({"a.xml": b"<a>1</a>\n<b/>", "b.bin": bytes(100)})

    def made(seed):
        random = numpy.random.default_rng(seed)
        return [mutate(random, data, [data]) for _ in range(20)]

    assert made(3) == made(3) != made(4)


def test_most_mutants_of_an_archive_are_archives():
    random = numpy.random.default_rng(0)
    data = packed({"a.xml": b"<a>1</a>\n<b/>", "b.bin": bytes(100)})
    made = [unpacked(of_archive(random, data, [data])) for _ in range(100)]
    assert sum(bool(m) for m in made) > 60
    assert sum(m != unpacked(data) for m in made) > 60


def test_every_target_has_inputs():
    for name, target in TARGETS.items():
        assert name == "run" or target.seeds(), name
