"""Requirements that cannot be read: one sentence with the column."""

from __future__ import annotations

import pytest

from cosim.base.errors import ScenarioError
from tests.cosim.formulas.recorded import declared

UNITS = {"arm.q[0]": "rad", "arm.q[1]": "rad", "arm.tau": "N.m"}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"always": "norm(am.q) <= 1 rad"}, "no recorded signal 'am.q'; did you mean 'arm.q'?"),
        ({"always": "arm.q <= 1 rda"}, "unknown unit 'rda' in 'rda', at column 12 of"),
        ({"always": "arm.tau <= 1 Nm"}, "did you mean 'N.m'?, at column 14 of"),
        ({"always": "arm.tau <= 1 rad"}, "found [N.m] and [rad], expected one unit, at column 9"),
        ({"always": "arm.q <= 1"}, "a number has no unit; expected one that fits [rad], at column"),
        ({"always": "arm.q[0] - arm.tau <= 1 rad"}, "found [rad] and [N.m], expected one unit"),
        ({"always": "arm.q - [1, 2, 3] rad <= 1 rad"}, "vectors of size 2 and 3, expected equal"),
        ({"always": "norm(arm.q <= 1 rad"}, "found '<=', expected ')', at column 12"),
        ({"always": "arm.q <= "}, "found the end, expected a signal, a number or a formula"),
        ({"always": "arm.q"}, "found a number, expected a comparison (<= or >=), at column 1"),
        ({"always": "arm.q <= 1 rad arm.tau"}, "found 'arm.tau', expected an operator or the end"),
        ({"always": "arm.q == 1 rad"}, "found '=='; expected e.g. abs(a - b) <= 0.01 rad"),
        ({"always": "arm.q @ 1 rad"}, "found '@', expected a formula, at column 7"),
        ({"always": "abs(arm.q, arm.tau) <= 1 rad"}, "abs takes one argument, found 2"),
        ({"always": "arm.q <= 1 rad", "within": ["3 s", "2 s"]}, "from 3 s to 2 s is empty"),
        ({"always": "arm.q <= 1 rad", "within": "2 m"}, "test.toml at require.one.within"),
        ({"always": "arm.q <= 1 rad", "within": "-2 s"}, "expected a time from the start on"),
        ({"always": "arm.q <= 1 rad", "within": 2, "after": 3}, "found 'within' and 'after'"),
        ({"formula": "always within [3 s, 2 s] arm.q <= 1 rad"}, "is empty, at column 15"),
        ({"formula": "always within 2 arm.q <= 1 rad"}, "unknown unit"),
        ({"formula": "arm.q <= 1 rad", "within": 2}, "'formula' takes no 'within'"),
        ({"formula": "arm.tau <= 1 N.m or arm.q >= arm.q"}, "no bound to divide by"),
        ({"metric": "sync <= 1 rad"}, "no metric 'sync'"),
        ({"within": "2 s"}, "found none, expected one of metric, always, eventually, formula"),
        ({"always": "a.x <= 1 m", "eventually": "a.x <= 1 m"}, "found always and eventually"),
        ({"alway": "a.x <= 1 m"}, "no key 'alway'; did you mean 'always'?"),
        ({"formula": "(" * 200 + "arm.q <= 1 rad" + ")" * 200}, "more than 100 parts"),
    ],
)
def test_bad_input_is_one_sentence(keys: dict[str, object], message: str) -> None:
    with pytest.raises(ScenarioError) as found:
        declared(UNITS, one=keys)
    assert message in str(found.value)
    assert str(found.value).startswith("test.toml at require.one")
    assert "\n" not in str(found.value)
