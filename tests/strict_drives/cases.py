"""The shipped deployments next to strict drives: what is started, and how it is run."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim.base.copies import replace
from tests.strict_drives.judged import DriveLog, read
from tests.vcan.rehearsals import environment

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
#: A step of a profile that has an answer, and the usual time for it.
STEP = r"(?m)((?:^read = \{|\{ id = (?![^}]*within)[^}]*expect = )[^}]*?) \}"
COSIM = (sys.executable, "-c", "from cosim.cli import main; main()")
SETUP = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
#: Root needs no namespace of users, and has real-time priorities without one.
USER = () if os.geteuid() == 0 else ("--user", "--map-root-user")
NAMESPACE = ("unshare", *USER, "--net", "sh", "-c", SETUP, "sh")
PATIENCE, GUEST = 240.0, 600.0  # s; the latter on the one processor of a kernel with CAN
CONTROLLERS = ("master_control", "slave_control")
#: A machine that stands still for a while ends no run here: what is judged are the drives.
CALM = tuple(f'deploy.nodes.{node}.overrun="2 s"' for node in CONTROLLERS)


@dataclass(frozen=True)
class Case:
    """A deployment with two arms on the buses `left` and `right`.

    `words`: arguments of the strict drives on both, `left`, `right`: further ones; `drives`: their
    numbers on each; `enabled`: their state; `feeds`, `step`: identifiers of what feeds them;
    `profile`: of the drives, instead of the deployment's (of a `relaxed` case).
    """

    kind: str
    scenario: str
    deploy: str
    drives: tuple[tuple[int, ...], tuple[int, ...]]
    words: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    enabled: str = ""
    feeds: int = 0
    step: int = 1
    profile: str = ""

    def feeding(self, side: int, number: int) -> int:
        """The identifier of the frames that feed the watchdog of a drive."""
        if self.kind in ("cia402", "ours"):  # of the node that commands it
            return self.feeds + (2, 4)[side]
        return self.feeds + self.step * number


def slow(*components: str, period: str) -> tuple[str, ...]:
    """Settings with a longer period, where many drives are processes of Python."""
    return tuple(f'components.{name}.period="{period}"' for name in components)


FOUR = ("master", "slave", *CONTROLLERS)
CASES: Mapping[str, Case] = {
    "damiao": Case(
        "damiao", "teleoperation", "can-damiao", ((1, 2), (1, 2)),
        ("--inertia", "3.3,1", "--damping", "1"), ("--start", "0.3"), ("--start", "0.6"), (*CALM,),
        "enabled",
    ),
    "odrive": Case(
        "odrive", "six_axis", "six_axis", (tuple(range(1, 7)), tuple(range(1, 7))),
        ("--timeout", "50", "--period", "10", "--beat", "10", "--damping", "1e-3",
         "--inertia", "4e-4,7e-4,2e-4,7e-5,2e-5,2e-5",
         "--spring", "0.05,0.05,0.05,0.02,0.02,0.02"),
        ("--start", "0.3"), ("--start", "0.6"), (*CALM, *slow(*FOUR, period="10 ms")),
        "closed loop", 0xE, 32,
    ),
    "cia402": Case(
        "cia402", "teleoperation", "can-cia402", ((11, 12), (11, 12)),
        ("--timeout", "50", "--inertia", "0.033,0.01", "--damping", "0.01"),
        ("--start", "3", "--host", "2"), ("--start", "6", "--host", "4"), (*CALM,),
        "operation enabled", 0x700,
    ),
    "openarm": Case(
        "damiao", "openarm", "openarm", (tuple(range(1, 8)), tuple(range(1, 8))),
        ("--fd", "--types", "8009,8009,4340,4340,4310,4310,4310",
         "--damping", "4,4,4,4,1,1,1", "--spring", "40,40,40,40,8,8,8"),
        ("--start", "0,0.3,0,0.6,0,0,0"), ("--start", "0.2,0.5,0.2,0.9,-0.2,0.1,0.2"),
        (*CALM, *slow(*FOUR, period="10 ms")), "enabled",
    ),
    "ours": Case(
        "ours", "teleoperation", "can", ((1,), (3,)),
        ("--timeout", "100", "--fd", "--armed"),
        ("--start", "0.3", "--host", "2"), ("--start", "0.6", "--host", "4"), (*CALM,), "active",
        0x3A0,
    ),
}  # fmt: skip


def relaxed(case: Case, folder: Path, ms: int) -> Case:
    """The case with longer watchdogs in its drives and in copies of their profiles, where a state
    that is as old is one, and so is an answer to a step.
    """
    text = (CONFIGS / "deploy" / f"{case.deploy}.toml").read_text("utf-8")
    text = text.replace('"../can/', f'"{CONFIGS}/can/')
    for profile in (CONFIGS / "drives").glob("*.toml"):
        own = re.sub(r'(?m)^watchdog = ".*?"', f'watchdog = "{ms} ms"', profile.read_text("utf-8"))
        own = re.sub(r'\bwithin = ".*?"', f'within = "{ms} ms"', own)
        own = re.sub(STEP, rf'\1, within = "{ms} ms" }}', own)
        for file in re.findall(r'"([\w./]+\.dbc)"', own):
            own = own.replace(f'"{file}"', f'"{(profile.parent / file).resolve()}"')
        (folder / profile.name).write_text(own, "utf-8")
        taken = f"{case.profile}.toml" if case.profile else profile.name
        text = text.replace(f'"../drives/{profile.name}"', f'"{folder / taken}"')
    deploy = folder / f"{case.deploy}.toml"
    deploy.write_text(text, "utf-8")
    words = list(case.words)
    if "--timeout" in words:
        words[words.index("--timeout") + 1] = str(ms)
    return replace(case, deploy=str(deploy), words=tuple(words))


@dataclass(frozen=True)
class Ended:
    """A run that is over: exit code, what it said, and the logs of the drives."""

    code: int
    said: str
    drives: Sequence[DriveLog]
    folder: Path


def run(
    case: Case,
    folder: Path,
    *,
    faults: Sequence[str] = (),
    stop: float = 3.0,
    channels: Sequence[str] = (),
) -> Ended:
    """``cosim rehearse --hardware`` with the case's drives.

    `faults`: of the left bus's; `channels`: SocketCAN interfaces of left, right and link, () for
    multicast in a namespace of its own.
    """
    return beside(case, folder, _command(case, folder, stop, channels), faults, channels)


def doctor(case: Case, folder: Path, faults: Sequence[str] = (), answers: str = "") -> Ended:
    """``cosim doctor --deploy`` with the case's drives; `answers`: to its questions, "": --yes.

    With answers the faults are those of both buses.
    """
    path = Path(case.deploy)
    path = path if path.is_file() else CONFIGS / "deploy" / f"{case.deploy}.toml"
    words = ["doctor", "--deploy", str(path), "-i", "udp_multicast"]
    if answers:
        return beside(case, folder, [*COSIM, *words], faults, right=faults, answers=answers)
    return beside(case, folder, [*COSIM, *words, "--yes"], faults)


def beside(
    case: Case,
    folder: Path,
    command: Sequence[str],
    faults: Sequence[str] = (),
    channels: Sequence[str] = (),
    right: Sequence[str] = (),
    answers: str = "",
) -> Ended:
    """A command beside the drives of a case; faults of the left and the right bus."""
    folder.mkdir(parents=True, exist_ok=True)
    logs = [folder / f"{side}.jsonl" for side in ("left", "right")]
    interface = "socketcan" if channels else "udp_multicast"
    drives = []
    for k, (own, log) in enumerate(zip((case.left, case.right), logs, strict=True)):
        channel = channels[k] if channels else f"239.74.163.{2 + k}"
        numbers = ",".join(map(str, case.drives[k]))
        words = [case.kind, "--interface", interface, "--channel", channel, "--drives", numbers]
        words += ["--log", str(log), *case.words, *own]
        drives.append([*words, *(w for f in (faults, right)[k] for w in ("--fault", f))])
    spec = folder / "bench.json"
    spec.write_text(json.dumps({"drives": drives, "command": list(command)}), "utf-8")
    bench = [sys.executable, "-m", "tests.strict_drives.bench", str(spec)]
    done = subprocess.run(
        bench if channels else [*NAMESPACE, *bench], cwd=ROOT, capture_output=True, text=True,
        timeout=GUEST if channels else PATIENCE, env=environment(folder / "lib"),
        input=answers,
    )  # fmt: skip
    return Ended(done.returncode, done.stdout + done.stderr, read(logs), folder / "run")


def _command(case: Case, folder: Path, stop: float, channels: Sequence[str]) -> list[str]:
    scenario = str(CONFIGS / f"{case.scenario}.toml")
    words = ["rehearse", scenario, "--deploy", case.deploy, "--nodes", ",".join(CONTROLLERS)]
    words += ["--hardware", "--yes", "--no-plot", "--no-twin", "--out", str(folder / "run")]
    for setting in (f'run.stop="{stop} s"', *case.settings):
        words += ["--set", setting]
    if channels:
        pairs = zip(("left", "right", "link"), channels, strict=False)
        words += [w for bus, name in pairs for w in ("-c", f"{bus}={name}")]
    else:
        words += ["-i", "udp_multicast"]
    return [*COSIM, *words]
