"""``cosim show`` prints the order and the inputs according to the algorithm."""

import json

import pytest
from typer.testing import CliRunner

from cosim.cli.commands import app
from tests.cosim.algorithms.test_gauss_seidel import OSCILLATOR
from tests.cosim.scenarios import document


def shown(tmp_path, **run):
    """What the command prints for the oscillator, `x` extrapolating."""
    written = document({**OSCILLATOR, "x": {**OSCILLATOR["x"], "extrapolate": "linear"}}, **run)
    path = tmp_path / "loop.toml"
    tables = [("run", written["run"])]
    tables += [(f"components.{n}", c) for n, c in written["components"].items()]
    path.write_text("\n".join(line for name, table in tables for line in _lines(name, table)))
    result = CliRunner().invoke(app, ["show", str(path)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def _lines(name, table):
    yield f"[{name}]"
    tables = {k: v for k, v in table.items() if isinstance(v, dict)}
    yield from (f"{k} = {json.dumps(v)}" for k, v in table.items() if k not in tables)
    for key, value in tables.items():
        yield from _lines(f"{name}.{key}", value)


@pytest.mark.parametrize("order", [["v", "x"], ["x", "v"], []])
def test_gauss_seidel_shows_its_order_and_whom_each_sees(tmp_path, order):
    text = shown(tmp_path, algorithm="gauss-seidel", order=order)
    first, second = order or ["v", "x"]  # they wait for each other: the first by name begins
    assert "algorithm gauss-seidel" in text
    stages = [line.split() for line in text.splitlines() if "t_k -> t_k + 0.25 s" in line]
    assert [stage[:2] for stage in stages] == [["2.", first], ["3.", second]]
    assert f"sees {second} as at t_k" in text
    assert f"sees newest of {first}" in text
    assert "the newest, computed before it steps" in text


def test_a_line_is_shown_where_one_is_taken(tmp_path):
    text = shown(tmp_path, algorithm="jacobi")
    found = {line.split()[0]: line for line in text.splitlines() if "<-" in line}
    assert "as the mean of a line through the last two over 0.25 s" in found["x.u"]
    assert "holds it 0.25 s" in found["v.u"]
