/* A live comparison: values of the links that can be moved, and the runs of all controllers that a worker
   computes with them. The page has the elements "live" (hidden until it is sure to work), "live-data" and
   "bundle". */
"use strict";
(() => {
  const { find, make, svg, live } = page;
  const place = find("live");
  if (!place || !live.able) return;
  const given = JSON.parse(find("live-data").textContent), said = find("live-said");
  const say = (text, wrong = false) => { said.textContent = text; said.classList.toggle("wrong", wrong); };

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
  const command = () => live.command(given.command, Object.entries(moved()).map(([path, x]) => `links.${law.value}.${path}=${x}`));

  // ---- the worker: the newest values win --------------------------------------------------------------

  let worker = null, ready = false, run = 0;
  function begin() {
    worker = live.worker(["engine", "measure", "compare_worker"], take, give_up);
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
    for (const [name, { show }] of controls) show(of(name), name in now);
    ask();
  }
  function control(path, one, number) {
    if (!number) controls.clear();
    const keyed = { ...one, key: `links.${law.value}.${path}` };
    const found = live.slider(number, keyed, (value) => set(path, value), (text) => say(`${path}: ${text}`, true));
    found.row.dataset.path = path;
    found.show(moved()[path] ?? one.value, path in moved());
    controls.set(path, found);
    return found.row;
  }
  find("live-reset").addEventListener("click", () => {
    for (const name of laws) values[name] = {};
    arrange();
    ask();
  });
  arrange();
  place.hidden = false;
  ask();
  live.idle(() => { if (!worker) try { begin(); } catch (error) { give_up(error.message); } });
})();
