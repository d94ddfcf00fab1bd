"""Least squares for an arm's parameters with errors that depend on each other, and their intervals.

Errors of each joint are taken as a first-order process: values and regressor less rho times those
before are used (Prais and Winsten), with rho from what is left, three times. What is correlated
between joints, and over :data:`_LAGS` values beyond this, widens the intervals (Newey and West).

Some errors are no noise. A drive whose torque is not the recorded one by a factor, a torque that
was recorded late, and friction that is larger near standstill each leave a trace of their own in
what is left: they are tried one by one, and one that stands out is estimated with the parameters,
which then have the intervals of the larger problem. Below which speed friction is larger is known
to one of a few speeds: half of the way to the next ones widens the intervals. An equal factor of
all drives leaves no trace: which of them is right is not known, so a factor of one widens all
intervals by as much.

Source: S. Prais and C. Winsten, "Trend estimators and serial correlation", Cowles Commission 383,
1954; W. Newey, K. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation
consistent covariance matrix", Econometrica 55(3), 1987.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from fmus.model.numeric import Array, np

#: Values after which errors are taken to be independent, beyond those of the first-order process.
_LAGS = 2
#: Standard errors by which a trace is beyond the largest that is expected without one.
_BEYOND = 0.5
#: Norm of what is left of a trace beside the parameters below which it cannot be seen.
_SEEN = 1e-4
#: Correlation of neighbouring values that is told.
_TOLD = 0.5


@final
@dataclass(frozen=True, slots=True)
class MeasuredTorques:
    """Rows of each joint, one in `spacing` s: the regressor `W` (k, n, p), `torque` (k, n) in N.m
    or N; `rate` (k, n, p): dW/dt in 1/s; `slow` (k, n, m): the sign of the speed near standstill,
    for each of m speeds that count as near.
    """

    W: Array
    torque: Array
    rate: Array
    slow: Array
    spacing: float

    def only(self, columns: list[int]) -> MeasuredTorques:
        """The same with these columns."""
        return MeasuredTorques(
            self.W[:, :, columns], self.torque, self.rate[:, :, columns], self.slow, self.spacing
        )


@final
@dataclass(frozen=True, slots=True)
class Trace:
    """An error of a `joint` that is no noise: `kind` is gain, late or slow; `value` ± `interval`
    (95 %): recorded torque less that of the model relative to it, s, or N.m.
    """

    kind: str
    joint: int
    value: float
    interval: float

    @property
    def text(self) -> str:
        """In a sentence."""
        if self.kind == "gain":
            found = f"{100 * self.value:+.3g} ± {100 * self.interval:.2g} %"
            return f"joint {self.joint}: the recorded torque differs from the acting one by {found}"
        if self.kind == "late":
            found = f"{1e3 * self.value:.3g} ± {1e3 * self.interval:.2g} ms"
            return f"joint {self.joint}: the torque was recorded {found} late"
        return (
            f"joint {self.joint}: friction near standstill differs by {self.value:.3g} ± "
            f"{self.interval:.2g}"
        )


@final
@dataclass(frozen=True, slots=True)
class ArmEstimate:
    """Values (p,) and half-widths of 95 % intervals (p,) in the units of the parameters; `rest`
    (k, n): torque not explained, N.m or N; `traces`: estimated with them; `memory` (n,): how long
    errors of a joint are correlated, s, 0 if hardly.
    """

    value: Array
    interval: Array
    rest: Array
    traces: tuple[Trace, ...]
    memory: Array


def estimate(data: MeasuredTorques) -> ArmEstimate:
    """The parameters of W that explain the torques best, with the traces that stand out."""
    _, n, p = data.W.shape
    kinds = [("gain", 0), ("late", 0), *(("slow", i) for i in range(data.slow.shape[2]))]
    open_traces = [(kind, j, i) for kind, i in kinds for j in range(n)]
    chosen: list[tuple[str, int, int]] = []
    value, interval, rho = _solved(data.W, data.torque)
    while True:
        tried = []
        for trace in open_traces:
            X, y = _linear(data, value[:p], [*chosen, trace])
            if _hidden(X):
                continue
            found, width, _ = _solved(X, y)
            tried.append((abs(found[-1] / width[-1]) * 1.96, trace))
        best = max(tried, default=(0.0, ("", 0, 0)))
        if best[0] < _BEYOND + np.sqrt(2.0 * np.log(len(kinds) * n)):
            break
        chosen.append(best[1])
        open_traces = [trace for trace in open_traces if trace[:2] != best[1][:2]]
        for _ in range(3):  # Gauss and Newton: columns of traces depend on the parameters
            X, y = _linear(data, value[:p], chosen)
            value, interval, rho = _solved(X, y)
    X, y = _linear(data, value[:p], chosen)
    traces = tuple(
        Trace(kind, j, float(value[p + i]), float(interval[p + i]))
        for i, (kind, j, _) in enumerate(chosen)
    )
    unsure = max((abs(trace.value) for trace in traces if trace.kind == "gain"), default=0.0)
    interval = interval[:p] + unsure * np.abs(value[:p]) + _unsure_speed(data, value[:p], chosen)
    memory = np.where(rho > _TOLD, -data.spacing / np.log(np.clip(rho, 1e-9, 0.999)), 0.0)
    return ArmEstimate(value[:p], interval, y - X @ value, traces, memory)


def _unsure_speed(data: MeasuredTorques, value: Array, chosen: list[tuple[str, int, int]]) -> Array:
    """Change of the parameters (p,) by half of the way to the next speed near standstill."""
    found = np.zeros(value.size)
    for place, (kind, j, i) in enumerate(chosen):
        for other in (i - 1, i + 1) if kind == "slow" else ():
            if 0 <= other < data.slow.shape[2]:
                traces = [*chosen[:place], (kind, j, other), *chosen[place + 1 :]]
                again, _, _ = _solved(*_linear(data, value, traces))
                found = np.maximum(found, 0.5 * np.abs(again[: value.size] - value))
    return found


def _linear(
    data: MeasuredTorques, value: Array, traces: list[tuple[str, int, int]]
) -> tuple[Array, Array]:
    """Columns (k, n, p + traces) and torques (k, n) of the model with traces, near `value` (p,)."""
    columns = []
    for kind, j, i in traces:
        column = np.zeros(data.torque.shape)
        source = {"gain": data.W, "late": -data.rate}.get(kind)
        column[:, j] = data.slow[:, j, i] if source is None else (source @ value)[:, j]
        columns.append(column)
    return np.concatenate([data.W, np.stack(columns, axis=2)], axis=2) if columns else data.W, (
        data.torque
    )


def _hidden(X: Array) -> bool:
    """True if the last column of X (k, n, p) is nearly a combination of those before."""
    flat = X.reshape(-1, X.shape[2])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    rest = flat[:, -1] - flat[:, :-1] @ np.linalg.lstsq(flat[:, :-1], flat[:, -1], rcond=None)[0]
    return bool(np.linalg.norm(rest) < _SEEN)


def _solved(X: Array, y: Array) -> tuple[Array, Array, Array]:
    """(values (p,), half-widths (p,), rho (n,)) of X (k, n, p) and y (k, n), in their units."""
    from scipy.stats import t as student

    k, n, p = X.shape
    rho, weight = np.zeros(n), np.ones(n)
    for turn in range(4):
        whitened, z = _whitened(X, rho) * weight[:, None], _whitened(y[:, :, None], rho)[:, :, 0]
        z = z * weight
        scale = np.maximum(np.linalg.norm(whitened.reshape(-1, p), axis=0), 1e-300)
        A = (whitened / scale).reshape(-1, p)
        value = np.linalg.lstsq(A, z.reshape(-1), rcond=None)[0]
        if turn == 3:
            break
        rest = y - X @ (value / scale)
        rho = _memory(rest, p / n)
        left = _whitened(rest[:, :, None], rho)[:, :, 0]
        sigma = np.sqrt(np.mean(left**2, axis=0))
        weight = 1.0 / np.maximum(sigma, 1e-9 * sigma.max() + 1e-300)
    scores = A * (z.reshape(-1) - A @ value)[:, None]
    spread = long_run(scores.reshape(k, n, p).sum(axis=1))
    inverse = np.linalg.pinv(A.T @ A)
    covariance = inverse @ spread @ inverse * (k * n) / max(1.0, k * n - p)
    width = float(student.ppf(0.975, max(1, k - 1))) * np.sqrt(np.diag(covariance))
    return value / scale, width / scale, rho


def _memory(rest: Array, used: float) -> Array:
    """The correlation of neighbours in `rest` (k, n), (n,), dimensionless, corrected for the
    `used` degrees of freedom of each joint, which make it smaller.
    """
    power = np.maximum(np.sum(rest**2, axis=0), 1e-300)
    found = np.sum(rest[1:] * rest[:-1], axis=0) / power
    corrected = found + (1.0 + found) * used / len(rest)
    return np.where(found > 2.0 / np.sqrt(len(rest)), np.clip(corrected, 0.0, 0.98), 0.0)


def _whitened(x: Array, rho: Array) -> Array:
    """`x` (k, n, m) less rho (n,) times the value before."""
    found = x.copy()
    found[1:] -= rho[:, None] * x[:-1]
    found[0] *= np.sqrt(1.0 - rho[:, None] ** 2)
    return np.asarray(found)


def long_run(scores: Array) -> Array:
    """The sum of the covariances (p, p) of `scores` (k, p) with themselves and their neighbours,
    in the square of their unit.
    """
    found = scores.T @ scores
    for lag in range(1, _LAGS + 1):
        product = scores[lag:].T @ scores[:-lag]
        found = found + (1.0 - lag / (_LAGS + 1.0)) * (product + product.T)
    return np.asarray(found)
