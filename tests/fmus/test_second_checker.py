"""The shipped FMUs before a second pair of eyes: the checks of fmu-manipulation-toolbox."""

from __future__ import annotations

import subprocess
import sys

import pytest

from fmus.build.archive import VERSIONS, find, shipped_models

CHECK = "from fmu_manipulation_toolbox.cli.fmutool import fmutool; fmutool()"


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", shipped_models(), ids=lambda m: m.identifier)
def test_a_second_checker_finds_nothing(model, version):
    command = [sys.executable, "-c", CHECK, "-input", str(find(model, version)), "-check"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    said = result.stdout + result.stderr
    assert result.returncode == 0, said
    assert f"compliant with FMI-{version}" in said, said
    assert f"No semantic error against the FMI-{version[0]} standard" in said, said
