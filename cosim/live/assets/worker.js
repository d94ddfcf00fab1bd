/* The worker of a live report: it computes a run with other values, judges it, and sends the page
   what it draws. Needs engine.js and measure.js in front of it. */
"use strict";
{
  let opened = null, asked = null;

  /** Rows that keep every extreme of y: the same as cosim.reporting.thinning. */
  function thin(y, most) {
    const n = y.length, kept = new Set([0, n - 1]);
    if (n <= most) return Array.from({ length: n }, (_, k) => k);
    const count = Math.floor((most - 2) / 2), edge = (i) => Math.floor((i * n) / count);
    for (let i = 0; i < count; i++) {
      let low = edge(i), high = low;
      for (let k = low + 1; k < edge(i + 1) && !Number.isNaN(y[low]); k++) {
        if (!(y[k] >= y[low])) low = k;
        if (!(y[k] <= y[high])) high = k;
      }
      kept.add(low).add(high);
    }
    return [...kept].sort((a, b) => a - b);
  }
  function curve(t, y, most) {
    const rows = thin(y, most);
    return { t: Float64Array.from(rows, (k) => t[k]), y: Float64Array.from(rows, (k) => y[k]) };
  }
  /** Values of a column at `count` times from `begin` on, `frame` s apart, on straight lines between rows. */
  function frames(t, y, { begin, frame, count }) {
    const found = new Float32Array(count), last = t.length - 1;
    for (let i = 0, k = 0; i < count; i++) {
      const s = begin + i * frame;
      while (k < last && t[k + 1] <= s) k++;
      const share = k < last ? Math.max(0, (s - t[k]) / (t[k + 1] - t[k])) : 0;
      found[i] = k < last ? y[k] + share * (y[k + 1] - y[k]) : y[last];
    }
    return found;
  }
  function news(result, seconds) {
    const { t } = result, columns = new Map();
    for (const { names, columns: found } of Object.values(result.signals)) names.forEach((name, i) => columns.set(name, found[i]));
    const seen = Measure.judge(asked.judged, new Measure.Rows(t, columns, asked.judged.entries), Boolean(result.failure));
    const curves = {}, tracks = (names) => (t.length ? names.map((name) => frames(t, columns.get(name), asked.arms)) : []);
    for (const [name, most] of Object.entries(asked.curves)) if (columns.has(name) && t.length) curves[name] = curve(t, columns.get(name), most);
    const failure = result.failure ? result.failure.text : "", { ended, digest } = result;
    return {
      curves, digest, failure, ended: ended ?? "", seconds, last: t.length ? t.at(-1) : NaN,
      arms: asked.arms.names.map(({ q, torque }) => ({ q: tracks(q), torque: tracks(torque) })),
      verdict: Measure.verdict(seen, failure, ended ?? ""), required: seen.required.map((r) => ({ ...r, margin: Measure.marginText(r) })),
      cards: seen.metrics.map((r, i) => Measure.card(asked.judged.metrics[i], r)),
      facts: seen.metrics.flatMap((r, i) => Measure.facts(asked.judged.metrics[i], r)),
    };
  }
  async function answer({ open, run, values }) {
    if (open) {
      asked = open;
      opened = await Live.open(JSON.parse(open.bundle));
      return { opened: true };
    }
    const begin = performance.now(), result = await opened.compute(values);
    const found = news(result, result.seconds);
    return { run, ...found, whole: (performance.now() - begin) / 1000 };
  }
  onmessage = async ({ data }) => {
    try { postMessage(await answer(data)); }
    catch (error) { postMessage({ run: data.run, refused: error.message || String(error) }); }
  };
}
