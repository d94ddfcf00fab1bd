/* A live comparison: values of the links that can be moved, and the runs of all controllers that a worker
   computes with them. The page has the elements "live" (hidden until it is sure to work), "live-data" and
   "bundle". */
"use strict";
(() => {
  const { find, make, svg } = page;
  const place = find("live"), able = typeof WebAssembly === "object" && typeof Worker === "function" && typeof DecompressionStream === "function";
  if (!place || !able) return;
  const given = JSON.parse(find("live-data").textContent), said = find("live-said");
  const say = (text, wrong = false) => { said.textContent = text; said.classList.toggle("wrong", wrong); };
  const tidy = (x) => Number(x.toPrecision(12));

  // ---- what is chosen ---------------------------------------------------------------------------------

  const laws = Object.keys(given.laws), values = Object.fromEntries(laws.map((law) => [law, {}])); // those moved, by path
  const select = (id, label, names) => {
    const one = make("select", { id }, ...names.map((name) => make("option", { value: name }, name)));
    one.addEventListener("change", () => { worker?.postMessage({ forget: true }); arrange(); ask(); });
    find("live-choices").append(make("label", {}, `${label} `, one), " ");
    return one;
  };
  const law = select("live-law", "link", laws);
  const operator = select("live-operator", "operator", given.operators);
  const mine = () => given.recorded.filter((one) => one.link === law.value && one.operator === operator.value);
  const controllers = [...new Set(given.recorded.map((one) => one.controller))];
  const boxes = new Map(controllers.map((name) => {
    const box = make("input", { type: "checkbox", "data-controller": name });
    box.checked = true;
    box.addEventListener("change", () => { arrange(); ask(); });
    find("live-controllers").append(make("label", {}, box, ` ${name} `), " ");
    return [name, box];
  }));
  const moved = () => values[law.value];
  const quoted = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'"'"'`)}'`);
  const command = () => [given.command, ...Object.entries(moved()).map(([path, x]) => `--set ${quoted(`links.${law.value}.${path}=${x}`)}`)].join(" ");

  // ---- the worker: the newest values win --------------------------------------------------------------

  let worker = null, ready = false, run = 0;
  function begin() {
    const scripts = ["engine", "measure", "compare_worker"].map((name) => `${find(`live-${name}`).textContent}\n`);
    worker = new Worker(URL.createObjectURL(new Blob(scripts, { type: "text/javascript" })));
    worker.onmessage = ({ data }) => take(data);
    worker.onerror = (event) => give_up(event.message || "its worker does not start");
    worker.postMessage({ open: { ...given.page, columns: given.columns, bundle: find("bundle").textContent } });
  }
  function give_up(why) {
    worker?.terminate();
    worker = null;
    place.querySelectorAll("input, select, #live-reset").forEach((one) => { one.disabled = true; });
    say(`This browser cannot run the simulation (${why}); the tables are of the recorded runs.`, true);
  }
  /** Run the chosen controllers with the values as they are. */
  function ask() {
    find("live-command").textContent = command();
    run++;
    const names = mine().map((one) => one.name).filter((name) => lines.has(name)), same = !Object.keys(moved()).length;
    if (same || !names.length) { // the recorded runs are known
      worker?.postMessage({ run, names: [], values: {} });
      place.removeAttribute("aria-busy");
      for (const one of mine()) show(one);
      say(names.length ? "as recorded" : "no controller is chosen", !names.length);
      return;
    }
    if (!worker) begin();
    place.setAttribute("aria-busy", "true");
    for (const { row } of lines.values()) row.classList.add("old");
    say(`computing ${names.length} runs …`);
    worker.postMessage({ run, names, values: { ...moved() } });
  }
  function take(data) {
    if (data.opened) { ready = true; return; }
    if (!ready) { give_up(data.refused); return; }
    if (data.run !== run) return;
    if (data.done) {
      place.removeAttribute("aria-busy");
      const shown = [...lines.values()], alive = shown.filter((one) => one.survives).length;
      say(`${alive} of ${shown.length} survive; computed in ${data.seconds.toPrecision(3)} s`);
    } else show(data);
  }

  // ---- the table ----------------------------------------------------------------------------------------

  const body = find("live-table").tBodies[0], lines = new Map();
  const columns = () => given.operator_columns[operator.value];
  const heads = [...find("live-table").tHead.rows[0].cells];
  function heights() {
    const starts = given.recorded.flatMap((one) => one.curves.map((curve) => curve.y[0]));
    const all = [...given.page.reference, ...starts, 0], low = Math.min(...all), high = Math.max(...all), more = 0.35 * (high - low) || 1;
    return [low - more, high + more];
  }
  const [low, high] = heights();
  function picture(curves) {
    const found = svg("svg", { viewBox: "0 0 120 36", role: "img", "aria-label": "curves" });
    curves.forEach(({ t, y }, i) => {
      const inside = t.map((s, k) => [s, y[k]]).filter(([, v]) => v !== null && v >= low && v <= high);
      const points = inside.map(([s, v]) => `${((120 * s) / given.page.until).toFixed(1)},${((36 * (high - v)) / (high - low)).toFixed(1)}`);
      found.append(svg("polyline", { points: points.join(" "), fill: "none", stroke: `var(--s${i % 7})` }));
    });
    return found;
  }
  /** A line of the table for each controller that is chosen. */
  function arrange() {
    lines.clear();
    body.replaceChildren();
    find("live-digests").replaceChildren();
    const chosen = mine().filter((one) => boxes.get(one.controller).checked);
    for (const { name, controller } of chosen) {
      const row = make("tr", { "data-controller": controller }, make("td", { class: "name", title: name }, controller));
      const digest = make("dd", { class: "digest", "data-controller": controller });
      find("live-digests").append(make("dt", {}, controller), digest);
      lines.set(name, { row, digest });
      body.append(row);
    }
    const seen = new Set(columns());
    given.columns.forEach(({ name }, i) => { heads[i + 3].hidden = !seen.has(name); });
    for (const [name, box] of boxes) box.disabled = !mine().some((one) => one.controller === name);
    const sliders = given.laws[law.value];
    find("live-values").replaceChildren(...Object.entries(sliders).map(([path, one], i) => control(path, one, i)));
  }
  function show(found) {
    const line = lines.get(found.name);
    if (!line) return;
    const { row, digest } = line;
    digest.textContent = found.digest ?? "";
    while (row.cells.length > 1) row.deleteCell(-1);
    row.classList.remove("old");
    line.survives = Boolean(found.survives);
    if (found.refused) { row.append(make("td", { colspan: heads.length - 1 }, found.refused)); return; }
    const cells = Array.isArray(found.cells) ? found.cells : given.columns.map(({ name }) => found.cells[name]);
    const word = found.survives ? "passed" : "failed", text = found.text.replace(/^(yes|no)(: )?/, (all, answer, more) => (more ? "" : answer));
    const told = make("span", { class: `told ${word}`, title: found.reason ?? "" }, `${found.survives ? "✓" : "✗"} ${text}`);
    row.append(make("td", { class: "name" }, told), make("td", {}, picture(found.curves)));
    given.columns.forEach(({ name }, i) => { if (columns().includes(name)) row.append(make("td", { class: "number" }, cells[i])); });
  }

  // ---- values -------------------------------------------------------------------------------------------

  const controls = new Map();
  function set(path, value) {
    const all = given.laws[law.value], now = moved();
    const put = (name, x) => { if (x === all[name].value) delete now[name]; else now[name] = x; };
    const of = (name) => now[name] ?? all[name].value;
    put(path, value);
    const [other, wrong] = path.endsWith(".low") ? [path.replace(/low$/, "high"), (x) => x < value] : [path.replace(/high$/, "low"), (x) => x > value];
    if (other !== path && other in all && wrong(of(other))) put(other, value);
    for (const [name, { range, field, row, at }] of controls) {
      range.value = String(at(of(name)));
      field.value = String(of(name));
      range.setAttribute("aria-valuetext", `${of(name)} ${all[name].unit}`);
      row.classList.toggle("moved", name in now);
    }
    ask();
  }
  /** The slider and the field of a value. Of a value with choices, the slider has the number of one. */
  function control(path, { label, about, unit, value, low: least, high: most, step, choices }, number) {
    if (!number) controls.clear();
    const id = `live-${number}`, title = `${about} links.${law.value}.${path}`, now = moved()[path] ?? value;
    const nearest = (x) => choices.reduce((best, one) => (Math.abs(one - x) < Math.abs(best - x) ? one : best));
    const at = (x) => (choices.length ? choices.indexOf(nearest(x)) : x);
    const grid = Math.min(value, tidy(value - Math.floor((value - least) / step + 1e-9) * step)); // it has the value
    const ends = choices.length ? { min: 0, max: choices.length - 1, step: 1 } : { min: grid, max: most, step };
    const range = make("input", { type: "range", id, ...ends, value: at(now) });
    const field = make("input", { type: "number", min: least, max: most, step: "any", value: now, "aria-label": `${label}, ${unit}`, title });
    const row = make("div", { class: `value${path in moved() ? " moved" : ""}`, "data-path": path }, make("label", { for: id, title }, label), range, make("span", {}, field, ` ${unit === "1" ? "" : unit}`));
    range.addEventListener("input", () => {
      const found = Number(range.value);
      set(path, choices.length ? choices[found] : Math.abs(found - value) < step / 1e3 ? value : tidy(found));
    });
    field.addEventListener("change", () => {
      const wrong = !field.checkValidity() || field.value === "";
      row.classList.toggle("wrong", wrong);
      if (wrong) say(`${path}: found ${field.value || "nothing"}, expected a number from ${least} to ${most}`, true);
      else set(path, choices.length ? nearest(Number(field.value)) : Number(field.value));
    });
    controls.set(path, { range, field, row, at });
    return row;
  }
  find("live-reset").addEventListener("click", () => {
    for (const name of laws) values[name] = {};
    arrange();
    ask();
  });
  arrange();
  place.hidden = false;
  ask();
  const idle = window.requestIdleCallback ?? ((call) => setTimeout(call, 200));
  idle(() => { if (!worker) try { begin(); } catch (error) { give_up(error.message); } });
})();
