"""Disks that are full or fill up, folders that cannot be written, too little memory, few files.

Whatever is missing: the run is complete, or one sentence, an exit code that is not 0, and all that
was recorded until then can be read.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from cosim.record import Run
from tests.bridge.zenoh.rehearsed import sockets
from tests.cli.command import CALL, CONFIG, ROOT
from tests.cli.outcomes import judge

#: In mount and user namespaces of its own: what is mounted there nobody else sees.
NAMESPACE = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c")
#: A disk of $1 on $2, $3 bytes of it taken; its files are copied to $4 at the end.
ON_A_DISK = """
mount -t tmpfs -o size=$1 none "$2" && shift
disk=$1 taken=$2 kept=$3 && shift 3
[ "$taken" = 0 ] || head -c "$taken" /dev/zero > "$disk/taken" || true
"$@"
code=$?
rm -f "$disk/taken"
cp -a "$disk/." "$kept"
exit $code
"""
RUN = ("run", str(CONFIG), "--quiet", "--no-plot")
TWIN = ("run", str(CONFIG), "--deploy", "can", "--quiet", "--no-plot")
LOCKSTEP = (
    "rehearse", str(CONFIG), "--deploy", "zenoh", "--clock", "lockstep", "--quiet", "--no-plot",
    "--no-twin", "--set", "run.stop=0.5",
)  # fmt: skip


def call(words: Sequence[str], cwd: Path, **environment: str) -> dict[str, object]:
    """What :func:`judge` judges."""
    done = subprocess.run(
        words, cwd=cwd, env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    return {"code": done.returncode, "said": done.stderr}


def on_a_disk(folder: Path, size: str, taken: str, words: Sequence[str]) -> dict[str, object]:
    """Run `cosim` with its output on a disk of `size`; what is there at its end is in `kept`."""
    possible = (
        shutil.which("unshare")
        and not subprocess.run(
            [*NAMESPACE, "mount -t tmpfs none /mnt"], capture_output=True
        ).returncode
    )
    if not possible:
        pytest.skip("no mount namespaces here")
    disk, kept = folder / "disk", folder / "kept"
    disk.mkdir()
    kept.mkdir()
    command = [*CALL, *words, "--out", str(disk / "here")]
    return call([*NAMESPACE, ON_A_DISK, "sh", size, str(disk), taken, str(kept), *command], folder)


@pytest.mark.parametrize(
    ("size", "taken", "words", "code"),
    [
        ("1m", "1m", RUN, 1),  # full at the start
        ("17m", "0", RUN, 1),  # fills up during the run
        *(
            pytest.param(size, taken, words, None, marks=pytest.mark.slow)
            for size, taken, words in (
                ("100k", "0", RUN),
                ("18m", "0", RUN),
                ("20m", "0", RUN),
                ("20m", "18m", (*RUN, "--set", "run.stop=2")),
                ("1m", "0", TWIN),
                ("60m", "0", TWIN),
                ("70m", "0", TWIN),
                ("100k", "100k", LOCKSTEP),
                ("100k", "0", LOCKSTEP),
                ("700k", "0", LOCKSTEP),
            )
        ),
    ],
)
def test_a_disk_that_is_full_or_fills_up(
    tmp_path: Path, size: str, taken: str, words: Sequence[str], code: int | None
) -> None:
    if words is LOCKSTEP:
        here = sockets(("master", "slave"), tmp_path)
        words = [*words, *(word for setting in here for word in ("--set", setting))]
    found = on_a_disk(tmp_path, size, taken, words)
    judge(tmp_path / "kept" / "here", found)
    assert found["code"] == code or code is None, found


def test_the_disk_is_large_enough_after_all(tmp_path: Path) -> None:
    """So the others fail for lack of room, and of nothing else."""
    found = on_a_disk(tmp_path, "100m", "0", (*RUN, "--set", "run.stop=2"))
    judge(tmp_path / "kept" / "here", found)
    assert found["code"] == 0, found
    assert len(Run.open(tmp_path / "kept" / "here")) == 2001


READ_ONLY = """
mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && shift && exec "$@"
"""


@pytest.mark.slow
@pytest.mark.parametrize("words", [RUN, TWIN], ids=["run", "twin"])
def test_home_and_cache_that_are_read_only(tmp_path: Path, words: Sequence[str]) -> None:
    """FMUs are unpacked among the temporary files."""
    home = tmp_path / "home"
    (home / ".cache").mkdir(parents=True)
    command = [*CALL, *words, "--set", "run.stop=1", "--out", str(tmp_path / "here")]
    words = [*NAMESPACE, READ_ONLY, "sh", str(home), *command]
    found = call(words, tmp_path, HOME=str(home), XDG_CACHE_HOME=str(home / ".cache"))
    assert found["code"] == 0, found
    judge(tmp_path / "here", found)


@pytest.mark.slow
def test_a_run_folder_that_is_read_only(tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    command = [*CALL, *RUN, "--set", "run.stop=1", "--out", str(place / "here")]
    found = call([*NAMESPACE, READ_ONLY, "sh", str(place), *command], tmp_path)
    assert found["code"] == 2 and "Read-only file system" in str(found["said"])
    judge(place / "here", found)


@pytest.mark.parametrize(
    "limit",
    [
        "-n 6",
        *(
            pytest.param(f"-{kind} {n}", marks=pytest.mark.slow)
            for kind, numbers in (
                ("n", (5, 7, 8, 10, 12, 16, 32)),
                ("v", (100_000, 200_000, 300_000, 400_000, 500_000, 600_000, 800_000, 1_200_000)),
            )
            for n in numbers
        ),
    ],
)
@pytest.mark.parametrize("kind", ["run", pytest.param("twin", marks=pytest.mark.slow)])
def test_few_files_or_little_memory(tmp_path: Path, limit: str, kind: str) -> None:
    """`ulimit`: as many open files, as many KiB of memory. (With 4 files Python cannot start.)"""
    words = RUN if kind == "run" else TWIN
    command = [*CALL, *words, "--set", "run.stop=1", "--out", str(tmp_path / "here")]
    found = call(["sh", "-c", f'ulimit {limit} && exec "$@"', "sh", *command], tmp_path)
    judge(tmp_path / "here", found)
