"""A unit that is not known is accepted nowhere: it is named, with the unit it may stand for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.faults.load import load as load_faults
from bridge.safety.limits import to_si
from cosim.base.convert import number
from cosim.base.errors import CosimError
from cosim.base.units import is_unit
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from fmus.arms.options import robot_of

ROOT = Path(__file__).resolve().parents[3]
CONFIGS = ROOT / "configs"
CONFIG = CONFIGS / "teleoperation.toml"
LETTERS = st.text("abcdefghijklmnopqrstuvwxyzNJWKAV", min_size=2, max_size=6)
UNKNOWN = LETTERS.filter(lambda text: not is_unit(text))


def scenario(value: str) -> None:
    assemble(load(CONFIG, [f'components.master.parameters.k_p="{value}"']))


def duration(value: str) -> None:
    assemble(load(CONFIG, [f'run.stop="{value}"']))


def delay(value: str) -> None:
    assemble(load(CONFIG, [f'links.0.delay.high="{value}"']))


ARM: dict[str, Any] = {"urdf": "fr3.urdf", "base": "base", "tip": "hand"}


def held(value: str) -> None:
    robot_of({**ARM, "fixed": {"joint3": value}}, CONFIGS / "robots")


def payload(value: str) -> None:
    robot_of({**ARM, "payload": {"mass": value}}, CONFIGS / "robots")


def limit(value: str) -> None:
    to_si(value, "N.m", "tau_max")


def plain(value: str) -> None:
    number(value, "rad", "to")


EVERY = (scenario, duration, delay, held, limit, plain)


@pytest.mark.parametrize("read", EVERY)
def test_nm_is_refused_with_the_unit_that_is_meant(read: Any) -> None:
    with pytest.raises(CosimError, match=r"'Nm'.*did you mean 'N\.m'"):
        read("5 Nm")


@given(unit=UNKNOWN)
@pytest.mark.parametrize("read", (held, limit, plain))
def test_no_unknown_unit_is_accepted(read: Any, unit: str) -> None:
    with pytest.raises(CosimError) as refused:
        read(f"5 {unit}")
    assert unit in str(refused.value)


def test_a_fault_script_refuses_an_unknown_unit(tmp_path: Path) -> None:
    script = tmp_path / "faults.toml"
    script.write_text('[[fault]]\nkind = "silence"\nnode = "master"\nat = "5 Nm"\nfor = 1\n')
    with pytest.raises(CosimError, match=r"fault"):
        load_faults(script)


@pytest.mark.parametrize("value", ["5 Nm", "5 kgg"])
def test_a_payload_refuses_an_unknown_unit(value: str) -> None:
    with pytest.raises(CosimError):
        payload(value)
