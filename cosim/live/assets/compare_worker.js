/* The worker of a live comparison: it runs controllers one after the other, and sends what the page shows of
   each. Needs engine.js and measure.js in front of it. */
"use strict";
{
  const DECAYS = 0.9, GROWS = 1.1, POINTS = 120; // as cosim.comparison.verdict; points of a small curve
  const opened = new Map();
  let given = null, cases = null, newest = 0;

  async function unpacked(text) {
    const raw = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const plain = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
    return JSON.parse(await new Response(plain).text());
  }
  async function simulator(name) {
    if (!opened.has(name)) {
      const { bundle } = cases[name], { shared, modules } = given.made;
      const mine = Object.fromEntries(bundle.components.map(({ module }) => [module, modules[module]]));
      opened.set(name, await Live.open({ ...bundle, ...shared, modules: mine }));
    }
    return opened.get(name);
  }

  /** Did a run come to rest? cosim.comparison.verdict: [stable, whole, text]. */
  function verdict(rows, failure) {
    const how = given.stable, { t } = rows, all = (names) => names.flatMap((name) => rows.array(name));
    const x = all(how.position), v = all(how.velocity);
    const most = (columns, k) => columns.reduce((a, column) => (Math.abs(column[k]) <= a ? a : Math.abs(column[k])), 0); // NaN is most
    const at = (time) => (Number.isFinite(time) ? ` at ${time.toFixed(2)} s` : "");
    for (let k = 0; k < t.length; k++) {
      if (!(most(x, k) <= how.position_limit && most(v, k) <= how.velocity_limit)) return [false, false, `no: diverged${at(t[k])}`];
    }
    if (failure) return [false, false, `no: stopped${at(failure.time)}`];
    const first = t[0], last = t.at(-1), sums = [0, 0], counts = [0, 0];
    let speed = 0;
    for (let k = 0; k < t.length; k++) {
      if (t[k] >= last - how.window) speed = Math.max(speed, most(v, k));
      const quarter = ((t[k] - first) * 4) / (last - first);
      if (quarter < 2) continue;
      const which = Number(quarter >= 3);
      for (const column of v) { sums[which] += column[k] ** 2; counts[which]++; }
    }
    if (speed < how.rest) return [true, true, "yes"];
    const [before, after] = sums.map((sum, i) => Math.sqrt(sum / counts[i]));
    const kind = after < DECAYS * before ? "settling" : after > GROWS * before ? "growing" : "moving";
    return [kind === "settling", true, `${kind === "settling" ? "yes" : "no"}: ${kind}, ${Measure.general(speed, 2)} rad/s`];
  }

  /** A number as the table shows it: cosim.comparison.rows.format_number, also where digits are half-way. */
  function shown(x, unit) {
    const even = (y, scale) => (Number.isInteger(2 * y * scale) && !Number.isInteger(y * scale) ? 2 * Math.round((y * scale) / 2) / scale : y);
    if (x === Infinity) return unit === "s" ? "never" : "∞";
    if (!Number.isFinite(x)) return x === -Infinity ? "-inf" : "–";
    if (unit === "s") return (Number.isInteger(4 * x) ? even(x, 10) : x).toFixed(1);
    if (Math.abs(x) > 0 && Math.abs(x) < 1e-3) return "<0.001";
    return Math.abs(x) >= 1000 ? even(x, 1).toFixed(0) : Measure.general(x, 3);
  }

  function news(result) {
    const columns = new Map();
    for (const { names, columns: found } of Object.values(result.signals)) names.forEach((name, i) => columns.set(name, found[i]));
    const rows = new Measure.Rows(result.t, columns, given.judged.entries);
    const [stable, whole, text] = verdict(rows, result.failure);
    const seen = whole ? Measure.judge(given.judged, rows) : { metrics: [], required: [] };
    if (whole) seen.required = given.required.flatMap((one) => Measure.judge({ ...given.judged, ...one }, rows).required);
    const cells = {}, missed = seen.required.find((r) => r.value < 0);
    given.columns.forEach(({ name, part, unit, margin }) => {
      const r = margin ? seen.required.find((one) => `${one.name}.margin` === name) : seen.metrics.find((one) => one.name === name);
      const x = !r ? NaN : part ? r.parts[part] ?? NaN : r.value;
      cells[name] = Number.isNaN(x) ? "–" : shown(x, unit);
    });
    const curves = given.curves.flatMap((name) => rows.array(name)).map((y) => {
      let n = result.t.findIndex((s) => s > given.until);
      if (n < 0) n = result.t.length;
      const step = Math.max(1, Math.floor(n / POINTS)), at = Array.from({ length: Math.ceil(n / step) }, (_, i) => i * step);
      return { t: at.map((k) => result.t[k]), y: at.map((k) => y[k]) };
    });
    return {
      cells, curves, digest: result.digest, survives: stable && !missed,
      text: stable && missed ? `no: ${missed.name} violated` : text, reason: result.failure?.text ?? "",
    };
  }

  async function compute({ run, names, values }) {
    newest = run;
    const begin = performance.now();
    for (const name of names) {
      await new Promise((go) => setTimeout(go)); // a newer message comes in here
      if (run !== newest) return;
      try {
        const moves = Object.entries(cases[name].moves).filter(([path]) => path in values);
        const of_keys = Object.fromEntries(moves.flatMap(([path, keys]) => keys.map((key) => [key, values[path]])));
        const found = news(await (await simulator(name)).compute(of_keys));
        postMessage({ run, name, ...found });
      } catch (error) { postMessage({ run, name, refused: error.message || String(error) }); }
    }
    if (names.length) postMessage({ run, done: true, seconds: (performance.now() - begin) / 1000 });
  }
  let before = Promise.resolve();
  onmessage = ({ data }) => {
    if (data.run) newest = data.run;
    before = before.then(async () => {
      if (data.open) {
        given = { ...data.open, made: JSON.parse(data.open.bundle) };
        cases = await unpacked(given.made.cases);
        postMessage({ opened: true });
      } else if (data.forget) opened.clear(); // other runs are chosen: their memory is not needed any more
      else if (data.run === newest) await compute(data);
    }).catch((error) => postMessage({ refused: error.message || String(error) }));
  };
}
