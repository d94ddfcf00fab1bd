"""Wheels for all platforms: ``python build_backend/wheels.py OUT [PLATFORM ...]``.

Each is built by zig in a copy of the committed sources, for the oldest systems that zig's targets
name, also for the platform of this machine: its own compiler would need this system's C library.
Needs the packages setuptools and ziglang (``pip install -e '.[dev]'``).
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from cosim_build import TAGS

ROOT = Path(__file__).resolve().parent.parent
#: Builds a wheel in the working directory; arguments: the folder for it, the platform.
_BUILD = """
import sys
sys.path.insert(0, "build_backend")
import cosim_build
cosim_build.build_wheel(sys.argv[1], {"platform": sys.argv[2]})
"""


def wheel(out: Path, platform: str) -> Path:
    """Build the wheel for `platform` into the folder `out`, and return its path.

    Raises KeyError for a platform that is none of ``TAGS``, CalledProcessError where a build fails.
    """
    from fmus.build.toolchain import zig

    tag = TAGS[platform]
    with tempfile.TemporaryDirectory(prefix="wheel-") as scratch:
        archive = ["git", "-C", str(ROOT), "archive", "--format=tar", "HEAD"]
        with subprocess.Popen(archive, stdout=subprocess.PIPE) as packed:
            subprocess.run(["tar", "-x", "-C", scratch], stdin=packed.stdout, check=True)
        environment = {**os.environ, "CC": shlex.join(zig(platform))}
        call = [sys.executable, "-c", _BUILD, str(out.resolve()), platform]
        done = subprocess.run(
            call, cwd=scratch, env=environment, check=False, capture_output=True, text=True
        )
        if done.returncode:
            print(done.stderr[-2000:], file=sys.stderr)
            done.check_returncode()
    (made,) = out.glob(f"*-{tag}.whl")
    return made


def main(arguments: list[str]) -> int:
    """Build the wheels of a command line; the exit code."""
    if not arguments or arguments[0].startswith("-") or {*arguments[1:]} - {*TAGS}:
        print(f"usage: wheels.py OUT [PLATFORM ...]; platforms: {', '.join(TAGS)}", file=sys.stderr)
        return 2
    out = Path(arguments[0])
    out.mkdir(parents=True, exist_ok=True)
    for platform in arguments[1:] or TAGS:
        print(wheel(out, platform), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
