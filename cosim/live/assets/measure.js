/* Metrics and requirements of recorded signals, as cosim.measure and cosim.formulas compute them,
   in words and numbers. No DOM: the same file in a page, in a worker and in Node. */
"use strict";
const Measure = (() => {
  // ---- numbers as text --------------------------------------------------------------------------

  /** Sign, digits without the point, and exponent of a number of `digits` significant digits; exact
      halves go to the even digit. */
  function rounded(x, digits) {
    const [mantissa, exponent] = Math.abs(x).toExponential(digits - 1).split("e");
    let found = mantissa.replace(".", "");
    const [exact, before] = Math.abs(x).toExponential(60).split("e");
    const rest = exact.replace(".", "").slice(digits), carried = before !== exponent; // to 10, even
    if (!carried && /^50*$/.test(rest) && Number(found.at(-1)) % 2 === 1) found = found.slice(0, -1) + String(Number(found.at(-1)) - 1);
    return [x < 0 || Object.is(x, -0) ? "-" : "", found, Number(exponent)];
  }
  const special = (x) => (Number.isNaN(x) ? "nan" : x > 0 ? "inf" : "-inf");
  const point = (digits, at) => `${digits.slice(0, at)}.${digits.slice(at)}`.replace(/\.?0*$/, "");
  /** A number as C's %g writes it. */
  function general(x, digits) {
    if (!Number.isFinite(x)) return special(x);
    const [sign, figures, e] = rounded(x, digits);
    if (x === 0) return `${sign}0`;
    if (e < -4 || e >= digits) return `${sign}${point(figures, 1)}e${e < 0 ? "-" : "+"}${String(Math.abs(e)).padStart(2, "0")}`;
    return sign + (e < 0 ? point("0".repeat(-e) + figures, 1) : point(figures, e + 1));
  }
  /** A number without decimals. */
  function integer(x) {
    if (!Number.isFinite(x)) return special(x);
    const low = Math.floor(x), half = x - low;
    const found = half > 0.5 || (half === 0.5 && low % 2 !== 0) ? low + 1 : low;
    return `${found < 0 || Object.is(found, -0) || (found === 0 && x < 0) ? "-" : ""}${BigInt(Math.abs(found))}`;
  }
  const TIMES = [["s", 1], ["ms", 1e-3], ["us", 1e-6], ["ns", 1e-9]];
  function timeText(seconds, digits = 4) {
    const size = Math.abs(Number(Number.isFinite(seconds) ? general(seconds, digits) : seconds));
    if (!(size > 0 && size < 10 ** digits)) return `${integer(seconds)} s`;
    const [unit, factor] = TIMES.find(([, least]) => size >= least) ?? TIMES.at(-1);
    return `${general(seconds / factor, digits)} ${unit}`;
  }
  const withUnit = (x, unit, digits = 3) => general(x, digits) + (unit === "" || unit === "1" ? "" : ` ${unit}`);

  const PRINTED = { u: "µ", Ohm: "Ω", deg: "°", degC: "°C" };
  const PREFIXES = { n: 1e-9, u: 1e-6, "µ": 1e-6, m: 1e-3, c: 1e-2, k: 1e3, M: 1e6, G: 1e9 };
  const SCALED = new Set(["s", "m", "rad", "N", "J", "W", "Pa", "V", "A", "Hz"]);
  const SYMBOLS = new Set(["1", "%", "rad", "deg", "rev", "s", "min", "h", "m", "g", "kg", "A", "K", "degC", "mol", "cd",
    "Hz", "rpm", "N", "J", "W", "Pa", "bar", "V", "Ohm", "C"]);
  const raised = (text) => text.replace(/[-\d]/g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(c)]));
  function printed(unit, scaled = "") {
    return unit.replace(/([A-Za-zµ%]+)\^?(-?\d+)?/g, (whole, symbol, power, at) => {
      let name = scaled && at === 0 ? scaled : symbol;
      name = PRINTED[name] ?? name;
      if (name.length > 1 && name[0] === "u" && SYMBOLS.has(name.slice(1))) name = `µ${PRINTED[name.slice(1)] ?? name.slice(1)}`;
      return name + raised(power ?? "");
    }).replace(/[.*]/g, "·");
  }
  /** A factor and a printed unit for numbers up to `greatest`: see cosim.base.units.prefixed. */
  function prefixed(greatest, unit) {
    const plain = unit === "" || unit === "1" ? "" : printed(unit);
    const first = /^([A-Za-zµ%]+|1)\^?(-?\d+)?$/.exec(unit.split(/[./*·]/)[0]);
    let size = Math.abs(greatest);
    if (!first || first[2] || !(size > 0 && size < Infinity)) return [1, plain];
    let name = first[1], own = 1;
    if (!SCALED.has(name) && name[0] in PREFIXES && SCALED.has(name.slice(1))) { own = PREFIXES[name[0]]; name = name.slice(1); }
    if (!SCALED.has(name)) return [1, plain];
    size *= own;
    let prefix = "";
    if (size < (name === "s" || name === "Hz" ? 1 : 0.1)) prefix = ["m", "u"].find((p) => size >= 0.9995 * PREFIXES[p]) ?? "n";
    else if (size >= 999.95 && name !== "s" && name !== "rad") prefix = ["G", "M"].find((p) => size >= 0.9995 * PREFIXES[p]) ?? "k";
    if (size < 1e-3 * PREFIXES.n) prefix = "";
    return [own / (PREFIXES[prefix] ?? 1), printed(unit, prefix + name)];
  }
  function readable(x, digits = 4) {
    const text = general(x, digits), [mantissa, exponent] = text.split("e");
    if (exponent === undefined) return text;
    if (Math.abs(x) >= 1 && Math.abs(x) < 1e6) return integer(Number(text));
    return `${mantissa} × 10${raised(String(Number(exponent)))}`;
  }
  /** A value with the unit in which a person reads it; a dash if it is not finite. */
  function engineering(x, unit, digits = 4) {
    if (!(Math.abs(x) < Infinity)) return "–";
    const [factor, shown] = prefixed(x, unit);
    return `${readable(factor * x, digits)} ${shown}`.trimEnd().replace(" °", "°");
  }
  function capital(text) {
    const word = text.split(/[ ,]/)[0];
    return [...word].length > 1 && /^\p{L}+$/u.test(word.replaceAll("'", "")) ? text[0].toUpperCase() + text.slice(1) : text;
  }

  // ---- signals ----------------------------------------------------------------------------------

  /** Recorded rows: `t` (n), s, and a column for each scalar by its name; `entries` has the names of
      the scalars of a signal. */
  class Rows {
    constructor(t, columns, entries) { Object.assign(this, { t, columns, entries }); }
    names(signal) { return this.entries[signal] ?? [signal]; }
    array(signal) {
      return this.names(signal).map((name) => {
        const column = this.columns.get(name);
        if (!column) throw new Error(`${name} was not recorded`);
        return column;
      });
    }
  }
  /** Signals side by side, with a sentence if there is no number. */
  function stack(rows, signals) {
    const names = signals.flatMap((name) => rows.names(name)), x = signals.flatMap((name) => rows.array(name));
    return { t: rows.t, x, names, problem: flaw(rows.t, x, names) };
  }
  function flaw(t, x, names) {
    if (!t.length) return "nothing was recorded";
    let row = t.length, which = -1;
    x.forEach((column, i) => {
      for (let k = 0; k < row; k++) if (!Number.isFinite(column[k])) { row = k; which = i; }
    });
    return which < 0 ? "" : `${names[which]} is ${special(x[which][row])} at ${general(t[row], 6)} s`;
  }

  // ---- numbers of signals -----------------------------------------------------------------------

  function over(n, value) {
    const found = new Float64Array(n);
    for (let k = 0; k < n; k++) found[k] = value(k);
    return found;
  }
  /** A sum whose error does not grow with the number of its terms (Neumaier). */
  function sum(n, term) {
    let total = 0, lost = 0;
    for (let k = 0; k < n; k++) {
      const v = term(k), next = total + v;
      lost += Math.abs(total) >= Math.abs(v) ? total - next + v : v - next + total;
      total = next;
    }
    return total + lost;
  }
  const integral = (y, t) => 0.5 * sum(t.length - 1, (k) => (t[k + 1] - t[k]) * (y[k + 1] + y[k]));
  function rootMeanSquare(y, t) {
    const lasts = t.at(-1) - t[0];
    return lasts > 0 ? Math.sqrt(integral(y.map((v) => v * v), t) / lasts) : Math.abs(y.at(-1));
  }
  /** The product of two vectors in each of n rows. */
  function dot(a, b, n) {
    const found = new Float64Array(n);
    a.forEach((column, i) => {
      const other = b[i];
      for (let k = 0; k < n; k++) found[k] += column[k] * other[k];
    });
    return found;
  }
  const length = (x, n) => dot(x, x, n).map(Math.sqrt);
  function largest(x, n) {
    const found = new Float64Array(n);
    for (const column of x) for (let k = 0; k < n; k++) {
      const size = Math.abs(column[k]);
      if (!(size <= found[k])) found[k] = size;
    }
    return found;
  }
  const intervalText = (t) => `over ${timeText(t.at(-1) - t[0])}`;
  function argmax(y) {
    let best = 0;
    for (let k = 1; k < y.length; k++) if (y[k] > y[best]) best = k;
    return best;
  }
  function settleTime(E, t, within) {
    let k = E.length - 1;
    while (k >= 0 && within > E[k]) k--;
    return k < 0 ? (t.length ? t[0] : NaN) : k + 1 < t.length ? t[k + 1] : Infinity;
  }
  /** The rows in the last seconds of `t`: the first one, and words. */
  function tail(t, window) {
    let words = `over the last ${timeText(window)}`;
    if (t.at(-1) - t[0] < window * (1 - 1e-9)) words = `${intervalText(t)}, which is all there is`;
    const least = t.at(-1) - window * (1 + 1e-9);
    return [t.findIndex((s) => s >= least), words];
  }
  function frequency(x, t) {
    const before = [];
    for (let k = 0; k + 1 < x.length; k++) if (x[k] < 0 !== x[k + 1] < 0) before.push(k);
    if (before.length < 3) return 0;
    const [first, last] = [before[0], before.at(-1)].map((k) => t[k] - (x[k] * (t[k + 1] - t[k])) / (x[k + 1] - x[k]));
    return (0.5 * (before.length - 1)) / (last - first);
  }

  // ---- metrics: cosim.measure.metrics and contact_metrics ----------------------------------------

  const result = (spec, value, detail, parts = {}, more = []) =>
    ({ name: spec.name, label: spec.label || spec.name, title: spec.title, value, unit: spec.unit, detail, parts, more });
  /** The signals of a target, or a column of one value for each number. */
  function targets(spec, rows) {
    if (typeof spec.target === "string") return spec.of.map(() => rows.array(spec.target));
    if (typeof spec.target[0] === "string") return spec.target.map((name) => rows.array(name));
    const fixed = spec.target.map((v) => new Float64Array(rows.t.length).fill(v));
    return spec.of.map(() => fixed);
  }
  const targetNames = (spec) => [spec.target].flat().filter((name) => typeof name === "string");
  const difference = (x, y) => x.map((column, i) => over(column.length, (k) => column[k] - y[i][k]));
  function error(spec, rows) {
    const { t, problem } = stack(rows, [...spec.of, ...targetNames(spec)]);
    if (problem) return result(spec, NaN, problem);
    const aims = targets(spec, rows), distance = spec.norm === "max" ? largest : length;
    const each = spec.of.map((name, i) => distance(difference(rows.array(name), aims[i]), t.length));
    const E = each.length > 1 ? over(t.length, (k) => Math.max(...each.map((e) => e[k]))) : each[0];
    const worst = argmax(E), rmse = rootMeanSquare(E, t), label = spec.label || spec.name, { unit, within } = spec;
    const parts = { final: E.at(-1), rmse, max: E[worst], max_at_s: t[worst] };
    const more = [[`${label}, RMS`, `${withUnit(rmse, unit)} ${intervalText(t)}`],
      [`${label}, peak`, `${withUnit(E[worst], unit)} at ${timeText(t[worst])}`]];
    if (within !== null) {
      parts.settle_s = settleTime(E, t, within);
      const band = `below ${withUnit(within, unit, 6)}`, after = parts.settle_s - t[0];
      more.push(["settled", after < Infinity ? `after ${timeText(after)} (${label} ${band})`
        : `never (${label} ${withUnit(E.at(-1), unit)} at the end, expected ${band})`]);
    }
    return result(spec, parts.final, `at the end (${timeText(t.at(-1))})`, parts, more);
  }
  const MEASURES = {
    norm: ({ t, x }) => [Math.sqrt(integral(length(x, t.length).map((v) => v ** 2), t)), intervalText(t), {}],
    integral_abs: ({ t, x }) => [integral(length(x, t.length), t), intervalText(t), {}],
    rms: ({ t, x }) => [rootMeanSquare(length(x, t.length), t), intervalText(t), {}],
    tail_mean: ({ t, x }, window) => {
      const [from, words] = tail(t, window), y = length(x.map((column) => column.subarray(from)), t.length - from);
      return [sum(y.length, (k) => y[k]) / y.length, words, {}];
    },
    vibration: ({ t, x, names }, window) => {
      const [from, words] = tail(t, window), last = x.map((column) => column.subarray(from));
      const ends = last.map((column) => column.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]));
      const swing = ends.map(([low, high]) => high - low), entry = argmax(swing), middle = 0.5 * (ends[entry][1] + ends[entry][0]);
      const hertz = frequency(last[entry].map((v) => v - middle), t.subarray(from));
      return [0.5 * swing[entry], `at ${general(hertz, 4)} Hz ${words} (${names[entry]})`, { frequency_hz: hertz }];
    },
    peak: ({ t, x, names }) => {
      const most = largest(x, t.length), row = argmax(most), entry = x.findIndex((column) => Math.abs(column[row]) === most[row]);
      return [most[row], `at ${timeText(t[row])} (${names[entry]})`, { at_s: t[row] }];
    },
    final: ({ t, x, names }, _, unit) => {
      const last = x.map((column) => column.at(-1)), parts = Object.fromEntries(names.map((name, i) => [name, last[i]]));
      const end = `at the end (${timeText(t.at(-1))})`;
      if (last.length === 1) return [last[0], end, parts];
      const entries = `(${last.map((v) => general(v, 4)).join(", ")})${withUnit(0, unit).slice(1)}`;
      return [Math.sqrt(last.reduce((all, v) => all + v * v, 0)), `${end}, length of ${entries}`, parts];
    },
  };
  const WORDS = { norm: "L2 norm", integral_abs: "integral of the magnitude", rms: "RMS", tail_mean: "mean magnitude" };
  function measure(spec, rows) {
    const s = stack(rows, spec.of);
    if (s.problem) return result(spec, NaN, s.problem);
    const [value, words, parts] = MEASURES[spec.kind](s, spec.window ?? 0, spec.unit);
    return result(spec, value, spec.kind in WORDS ? `(${WORDS[spec.kind]} of ${spec.listed} ${words})` : words, parts);
  }
  function phase(spec, rows) {
    const s = stack(rows, spec.of), touched = stack(rows, spec.contact), { t } = s;
    if (s.problem || touched.problem) return result(spec, NaN, s.problem || touched.problem);
    const aim = typeof spec.target === "string" ? rows.array(spec.target) : spec.target.map((v) => new Float64Array(t.length).fill(v));
    const apart = length(difference(s.x, aim), t.length).map((v) => v ** 2);
    const touches = over(t.length, (k) => Number(touched.x.some((column) => column[k] !== 0)));
    const within = (k) => Boolean(touches[k] || touches[k + 1]) === (spec.kind === "rms_contact");
    const lasts = sum(t.length - 1, (k) => (within(k) ? t[k + 1] - t[k] : 0));
    if (!(lasts > 0)) return result(spec, NaN, "the phase never occurs");
    const mean = sum(t.length - 1, (k) => (within(k) ? 0.5 * (apart[k + 1] + apart[k]) * (t[k + 1] - t[k]) : 0)) / lasts;
    return result(spec, Math.sqrt(mean), `RMS over ${timeText(lasts)}`, { lasts_s: lasts });
  }
  function runningIntegral(y, t) {
    const found = new Float64Array(t.length);
    for (let k = 1; k < t.length; k++) found[k] = found[k - 1] + ((t[k] - t[k - 1]) * (y[k] + y[k - 1])) / 2;
    return found;
  }
  function energy(spec, rows) {
    const each = spec.of.map((name) => stack(rows, [name])), problem = each.find((s) => s.problem)?.problem;
    if (problem) return result(spec, NaN, problem);
    const { t } = each[0], first = dot(each[0].x, each[1].x, t.length);
    const power = each.length < 4 ? first : difference([first], [dot(each[2].x, each[3].x, t.length)])[0];
    const E = runningIntegral(power, t), row = argmax(E.map((v) => -v)), label = spec.label || spec.name;
    const putIn = runningIntegral(first.map((v) => Math.max(v, 0)), t).at(-1), parts = { final: E.at(-1), put_in: putIn };
    if (putIn > 0) parts.least_share = E[row] / putIn;
    return result(spec, E[row], `at ${timeText(t[row])}`, parts, [[`${label}, end`, `${general(E.at(-1), 4)} J at ${timeText(t.at(-1))}`]]);
  }
  const KINDS = { error, energy, rms_free: phase, rms_contact: phase };
  const evaluated = (spec, rows) => (KINDS[spec.kind] ?? measure)(spec, rows);
  const metricText = (r) => (Number.isNaN(r.value) ? `no number: ${r.detail}` : `${withUnit(r.value, r.unit, 4)} ${r.detail}`.trimEnd());
  const unitOf = (part, unit) => (part.endsWith("_s") ? "s" : part.endsWith("_hz") ? "Hz" : part.endsWith("_share") ? "1" : unit);
  /** Value and parts by name, each with its unit. */
  const numbers = (r) => [[r.name, [r.value, r.unit]], ...Object.entries(r.parts).map(([key, x]) => [`${r.name}.${key}`, [x, unitOf(key, r.unit)]])];

  // ---- terms: cosim.formulas.terms ----------------------------------------------------------------

  /** A function of columns entry by entry; a vector of one entry, and a column of one row, fit all. */
  function joined(of, combine) {
    const size = Math.max(...of.map((x) => x.length)), n = Math.max(...of.map((x) => x[0].length));
    return Array.from({ length: size }, (_, i) => {
      const columns = of.map((x) => x[x.length === 1 ? 0 : i]).map((column) => (column.length === n ? column : new Float64Array(n).fill(column[0])));
      const [a, b] = columns;
      if (columns.length === 1) return over(n, (k) => combine(a[k]));
      if (columns.length === 2) return over(n, (k) => combine(a[k], b[k]));
      return over(n, (k) => combine(...columns.map((column) => column[k])));
    });
  }
  const OPERATORS = {
    neg: (x) => joined(x, (a) => -a), abs: (x) => joined(x, Math.abs),
    "+": (x) => joined(x, (a, b) => a + b), "-": (x) => joined(x, (a, b) => a - b),
    "*": (x) => joined(x, (a, b) => a * b), "/": (x) => joined(x, (a, b) => a / b),
    norm: ([x]) => [length(x, x[0].length)],
    max: (x) => (x.length === 1 ? joined(x[0].map((column) => [column]), Math.max) : joined(x, Math.max)),
    min: (x) => (x.length === 1 ? joined(x[0].map((column) => [column]), Math.min) : joined(x, Math.min)),
  };
  /** The value of a term in SI: a column for each of its entries. */
  function value(term, lookup) {
    if (term.kind === "constant") return term.values.map((v) => Float64Array.of(v));
    if (term.kind === "signal") {
      const x = lookup(term.name);
      return term.gain === 1 && !term.offset ? x : x.map((column) => column.map((v) => term.gain * v + term.offset));
    }
    return OPERATORS[term.kind](term.of.map((part) => value(part, lookup)));
  }

  // ---- robustness: cosim.formulas.robust ------------------------------------------------------------

  const SAME = 1e-6;
  /** The last row whose time is at most s, -1: none is; `t` (n) ascends. */
  function lastAt(t, s) {
    let low = 0, high = t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (t[middle] <= s) low = middle + 1; else high = middle;
    }
    return low - 1;
  }
  /** The extreme of x over rows first to last of windows, none of which begins or ends before that
      in front of it; a window with its last row before its first is empty, anywhere. */
  function extremes(x, first, last, most, empty) {
    const better = most ? (a, b) => a >= b : (a, b) => a <= b, found = new Float64Array(first.length).fill(empty);
    const queue = new Int32Array(x.length);
    let head = 0, end = 0, next = 0;
    for (let k = 0; k < first.length; k++) {
      if (last[k] < first[k]) continue;
      for (; next <= last[k]; next++) {
        while (end > head && better(x[next], x[queue[end - 1]])) end--;
        queue[end++] = next;
      }
      while (queue[head] < first[k]) head++;
      found[k] = x[queue[head]];
    }
    return found;
  }
  /** Recorded signals with the values of formulas on them; `beyond`: a row behind the last one, for
      what is not recorded, is as bad (-1) or as good (1) as possible; null: there is none. */
  class Trace {
    constructor(t, lookup, end, beyond = null) {
      const span = (t.at(-1) - t[0]) / Math.max(1, t.length - 1);
      this.same = span > 0 ? SAME * span : SAME;
      this.lookup = lookup; this.rows = t.length; this.beyond = beyond;
      this.t = beyond === null ? t : over(t.length + 1, (k) => (k < t.length ? t[k] : t.at(-1) + 4 * this.same));
      this.end = beyond === null ? t.at(-1) : Math.max(end, t.at(-1));
      this.known = new Map();
    }
    /** First and last row of an interval from a row on; `behind`: the tail of the formula in it. */
    window(interval, behind, row) {
      const s = this.t[row], begin = s + (interval.begin + this.same), open = interval.end === null;
      const end = open ? this.end - behind : this.beyond === null ? this.end : Infinity;
      const last = lastAt(this.t, open ? end + this.same : s + (interval.end + this.same));
      return [lastAt(this.t, begin), begin - 2 * this.same > end ? -1 : last];
    }
    windows(interval, behind) {
      const first = new Int32Array(this.t.length), last = new Int32Array(this.t.length);
      for (let row = 0; row < first.length; row++) [first[row], last[row]] = this.window(interval, behind, row);
      return [first, last];
    }
    values(formula) {
      if (!this.known.has(formula)) this.known.set(formula, FORMULAS[formula.op].over(formula, this));
      return this.known.get(formula);
    }
    at(formula, row) {
      const direct = FORMULAS[formula.op].first;
      return row === 0 && direct && !this.known.has(formula) ? direct(formula, this) : this.values(formula)[row];
    }
    decisive(formula, row) { return FORMULAS[formula.op].decisive(formula, this, row); }
  }
  const needed = (formula) => (formula.end === null ? formula.begin : formula.end);
  const tailOf = (formula) => FORMULAS[formula.op].tail(formula);
  function extremeAt(f, trace, row) {
    const [first, last] = trace.window(f, tailOf(f.of), row), x = trace.values(f.of);
    let best = -1;
    for (let k = first; k <= last; k++) if (best < 0 || (f.eventually ? x[k] > x[best] : x[k] < x[best])) best = k;
    return best < 0 ? [f.eventually ? -Infinity : Infinity, -1] : [x[best], best];
  }
  function untilAt(f, trace, row) {
    const [first, last] = trace.window(f, Math.max(tailOf(f.left), tailOf(f.right)), row);
    if (last < first) return [-Infinity, row, null];
    const left = trace.values(f.left), right = trace.values(f.right);
    let before = Infinity, least = -1, best = [-Infinity, -1, 0, 0];
    for (let k = row; k <= last; k++) {
      if (k >= first) {
        const each = Math.min(right[k], before);
        if (best[1] < 0 || each > best[0]) best = [each, k, before, least];
      }
      if (least < 0 || left[k] < before) least = k;
      before = Math.min(before, left[k]);
    }
    const [robust, at, held, worst] = best;
    return right[at] <= held ? [robust, at, f.right] : [robust, worst, f.left];
  }
  const FORMULAS = {
    held: {
      tail: () => 0, decisive: (f, trace, row) => row,
      over(f, trace) {
        const x = value(f.margin, trace.lookup), worst = f.negated ? Infinity : -Infinity, n = trace.rows;
        const found = new Float64Array(n + (trace.beyond === null ? 0 : 1));
        found.fill(Infinity, 0, n);
        for (const column of x) for (let k = 0; k < n; k++) {
          const v = column[column.length === 1 ? 0 : k];
          if (!Number.isFinite(v)) found[k] = NaN;
          else if (v < found[k]) found[k] = v; // NaN stays
        }
        for (let k = 0; k < n; k++) found[k] = Number.isNaN(found[k]) ? worst : found[k] / f.scale;
        if (trace.beyond !== null) found[n] = -trace.beyond * worst;
        return found;
      },
    },
    not: {
      tail: (f) => tailOf(f.of), over: (f, trace) => trace.values(f.of).map((v) => -v),
      first: (f, trace) => -trace.at(f.of, 0), decisive: (f, trace, row) => trace.decisive(f.of, row),
    },
    both: {
      tail: (f) => Math.max(tailOf(f.left), tailOf(f.right)),
      over(f, trace) {
        const left = trace.values(f.left), right = trace.values(f.right), combine = f.either ? Math.max : Math.min;
        return left.map((v, k) => combine(v, right[k]));
      },
      first: (f, trace) => (f.either ? Math.max : Math.min)(trace.at(f.left, 0), trace.at(f.right, 0)),
      decisive(f, trace, row) {
        const left = trace.at(f.left, row), right = trace.at(f.right, row);
        return trace.decisive((f.either ? left >= right : left <= right) ? f.left : f.right, row);
      },
    },
    extreme: {
      tail: (f) => needed(f) + tailOf(f.of), first: (f, trace) => extremeAt(f, trace, 0)[0],
      over: (f, trace) => extremes(trace.values(f.of), ...trace.windows(f, tailOf(f.of)), f.eventually, f.eventually ? -Infinity : Infinity),
      decisive(f, trace, row) {
        const [, at] = extremeAt(f, trace, row);
        return at < 0 ? null : trace.decisive(f.of, at);
      },
    },
    until: {
      tail: (f) => needed(f) + Math.max(tailOf(f.left), tailOf(f.right)), first: (f, trace) => untilAt(f, trace, 0)[0],
      over(f, trace) {
        const left = trace.values(f.left), right = trace.values(f.right), n = left.length;
        const [first, last] = trace.windows(f, Math.max(tailOf(f.left), tailOf(f.right)));
        const behind = last.reduce((a, b) => Math.max(a, b), -1) + 1, ends = new Float64Array(behind);
        let later = -Infinity;
        for (let k = behind - 1; k >= 0; k--) ends[k] = later = Math.max(right[k], Math.min(left[k], later));
        const before = extremes(left, Int32Array.from({ length: n }, (_, k) => k), first.map((k) => k - 1), false, Infinity);
        const most = f.end === null ? null : extremes(right, first, last, true, -Infinity);
        return over(n, (k) => (last[k] < first[k] ? -Infinity : Math.min(before[k], ends[first[k]], most ? most[k] : Infinity)));
      },
      decisive(f, trace, row) {
        const [, at, of] = untilAt(f, trace, row);
        return of === null ? null : trace.decisive(of, at);
      },
    },
  };

  // ---- requirements: cosim.measure.requirements -------------------------------------------------------

  const MISSING = 1.5, SETTLES = ".settle_s";
  const CALLED = { always: ["worst", "closest"], eventually: ["closest", "best"] };
  /** The time until which a run is known, and its end, s. */
  function covered(t, end) {
    const last = t.at(-1);
    if (end === null || end <= last) return [last, last];
    const step = (last - t[0]) / Math.max(1, t.length - 1);
    return end - last <= MISSING * step ? [end, last] : [last, end];
  }
  function robustness(spec, rows, end, metrics) {
    const { t } = rows, outcome = (verdict, margin, time, text) =>
      ({ name: spec.name, verdict, value: margin, unit: spec.unit, time, text: `${verdict}, ${text}`, condition: spec.condition });
    const undecided = (why) => ({ ...outcome("inconclusive", NaN, NaN, ""), text: `inconclusive: ${why}` });
    const margin = (x) => `margin ${withUnit(x, spec.unit, 4)}${spec.relative ? " of its bound" : ""}`;
    if (!t.length) return undecided("nothing was recorded");
    const [known, last] = covered(t, end);
    if (spec.metrics.length) return ofMetrics(spec, metrics, known, last, { outcome, undecided, margin });
    const lookup = (name) => rows.array(name), { formula } = spec;
    let trace = new Trace(t, lookup, last), high = trace.at(formula, 0), low = high;
    if (known < last || t[0] + tailOf(formula) > known + 1e-9 * (known - t[0])) {
      const other = new Trace(t, lookup, last, -1);
      trace = new Trace(t, lookup, last, 1);
      high = trace.at(formula, 0); low = other.at(formula, 0);
      if (high === Infinity) trace = other;
    }
    const found = trace.at(formula, 0), row = trace.decisive(formula, 0);
    if (row === null || row === t.length) return undecided(`its interval is beyond the end of the run at ${timeText(known)}`);
    const time = t[row];
    if (low < 0 && high >= 0) return outcome("inconclusive", found, time, `${margin(found)} when the run ended at ${timeText(known)}`);
    if (!Number.isFinite(found)) return outcome("failed", -Infinity, time, `${bad(spec.names, lookup, row)} at ${timeText(time)}`);
    const called = CALLED[spec.word]?.[Number(found >= 0)] ?? "decided";
    return outcome(found >= 0 ? "passed" : "failed", found, time, `${margin(found)}, ${called} at ${timeText(time)}`);
  }
  function ofMetrics(spec, metrics, known, last, { outcome, undecided, margin }) {
    if (known < last) return undecided(`the run ended at ${timeText(known)} of ${timeText(last)}`);
    const results = metrics.filter((r) => spec.metrics.includes(r.name)), each = Object.fromEntries(results.flatMap(numbers));
    for (const name of spec.names) each[name] ??= [NaN, "1"];
    const told = (name, [x, unit]) => (x === Infinity && name.endsWith(SETTLES)
      ? `${name.slice(0, -SETTLES.length)} has not settled at the end` : `${name} is ${withUnit(x, unit, 4)}`);
    const found = spec.names.map((name) => told(name, each[name])).join(", ");
    const of = (number) => new Trace(Float64Array.of(0), (name) => [Float64Array.of(number(name, each[name][0]))], 0).at(spec.formula, 0);
    const robust = of((name, x) => x);
    if (Number.isFinite(robust)) return outcome(robust >= 0 ? "passed" : "failed", robust, NaN, `${margin(robust)}, ${found}`);
    if (of((name, x) => (x === Infinity && name.endsWith(SETTLES) ? last : x)) >= 0) return undecided(`${found} of the run at ${timeText(last)}`);
    const missing = results.find((r) => Number.isNaN(r.value));
    return outcome("failed", -Infinity, NaN, missing ? metricText(missing) : found);
  }
  function bad(names, lookup, row) {
    for (const name of names) {
      const x = lookup(name), entry = x.findIndex((column) => !Number.isFinite(column[row]));
      if (entry >= 0) return `${name}${x.length > 1 ? `[${entry}]` : ""} is ${special(x[entry][row])}`;
    }
    return "the margin is not a finite number";
  }
  function stopped(spec, time) {
    const at = Number.isFinite(time) ? ` at ${timeText(time)}` : "";
    return { name: spec.name, verdict: "failed", value: -Infinity, unit: spec.unit, time, text: `failed, the run stopped${at}`, condition: spec.condition };
  }
  const marginText = (r) => (Number.isNaN(r.value) ? "" : withUnit(r.value, r.unit, 4));
  const worst = (results) => ["failed", "inconclusive", "passed"].find((word) => results.some((r) => r.verdict === word));

  /** Metrics and requirements of `document` (cosim.live.judged) on rows; `failed`: the run stopped. */
  function judge(document, rows, failed = false) {
    const metrics = document.metrics.map((spec) => evaluated(spec, rows)), last = rows.t.length ? rows.t.at(-1) : NaN;
    const required = document.require.map((spec) => (failed ? stopped(spec, last) : robustness(spec, rows, document.end, metrics)));
    return { metrics, required };
  }

  // ---- as a report shows them: cosim.reporting.run_report and labels -----------------------------------

  /** The verdict of a run: [word, reason]. */
  function verdict({ metrics, required }, failure = "", ended = "") {
    if (failure) return ["error", failure];
    if (ended) return ["finished", ended];
    const word = worst(required);
    if (word) {
      const missed = required.filter((r) => r.verdict === word).map((r) => `${r.name}: ${r.text}`).join("; ");
      return [word, word !== "passed" ? missed : required.length === 1 ? "the requirement is met" : "every requirement is met"];
    }
    const judged = metrics.filter((r) => "settle_s" in r.parts), late = judged.filter((r) => !Number.isFinite(r.parts.settle_s));
    if (late.length) return ["failed", `${late.map((r) => r.title).join(", ")}: never within its bound`];
    if (!judged.length) return ["finished", "the scenario declares no bound to judge by"];
    return ["passed", `every error with a bound stays within it from ${engineering(Math.max(...judged.map((r) => r.parts.settle_s)), "s")} on`];
  }
  /** The card of a metric: label, value, note. */
  function card(spec, r) {
    let note = "";
    if (spec.kind === "error" && spec.within !== null) {
      const settled = r.parts.settle_s ?? Infinity, bound = engineering(spec.within, r.unit);
      note = Number.isFinite(settled) ? `below ${bound} after ${engineering(settled, "s")}` : `not below ${bound} at the end`;
    }
    if ((r.parts.frequency_hz ?? 0) > 0) note = `at ${engineering(r.parts.frequency_hz, "Hz")}`;
    if ("at_s" in r.parts) note = `at ${engineering(r.parts.at_s, "s")}`;
    note = { norm: "L2 norm", integral_abs: "integral" }[spec.kind] ?? note;
    return [spec.shown, engineering(r.value, r.unit), note];
  }
  /** Label and text of each fact of a metric, for a table; its label becomes its title. */
  function facts(spec, r) {
    const mine = r.more.filter(([name]) => name.startsWith(r.label)).map(([name, text]) => [spec.title + name.slice(r.label.length), text]);
    const others = r.more.filter(([name]) => !name.startsWith(r.label));
    const first = [spec.title, `${engineering(r.value, r.unit)} ${r.detail}`.trimEnd()];
    return [first, ...mine, ...others].map(([label, text]) => [capital(label), text]);
  }

  return { Rows, judge, verdict, card, facts, marginText, metricText, engineering, timeText, general };
})();
if (typeof module !== "undefined") module.exports = Measure;
