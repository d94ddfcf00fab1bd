/* A live report: values that can be moved, and the run that a worker computes with them. The page has
   the elements "live" (hidden until it is sure to work), "live-data", "bundle" and "live-worker". */
"use strict";
(() => {
  const { find, make } = page;
  const place = find("live"), able = typeof WebAssembly === "object" && typeof Worker === "function" && typeof DecompressionStream === "function";
  if (!place || !able || !page.report) return;
  const given = JSON.parse(find("live-data").textContent), said = find("live-said");
  const recorded = Object.fromEntries(given.keys.map(({ key, value }) => [key, value]));
  const values = { ...recorded };
  const moved = () => Object.keys(values).filter((key) => values[key] !== recorded[key]);

  // ---- the command that gives this run ------------------------------------------------------------

  const quoted = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'"'"'`)}'`);
  /** The setting that gives a value; of what is not in the file, the whole list or table is set. */
  function setting(key) {
    const [path, parts] = Object.entries(given.added).find(([, some]) => some.includes(key)) ?? [key, [key]];
    return `${path}=${parts.map((one) => values[one] ?? one).join("")}`;
  }
  const command = () => [given.command, ...new Set(moved().map(setting))].map((one, i) => (i ? `--set ${quoted(one)}` : one)).join(" ");

  // ---- the worker: the newest values win --------------------------------------------------------------

  const PATIENCE = 1000; // ms after which a run with old values is given up
  let worker = null, address = "", ready = false, busy = null, wanted = false, number = 0, lasts = 0;
  function begin() {
    const scripts = ["live-engine", "live-measure", "live-worker"].map((id) => find(id).textContent);
    address ||= URL.createObjectURL(new Blob(scripts.map((text) => `${text}\n`), { type: "text/javascript" }));
    worker = new Worker(address);
    ready = false;
    worker.onmessage = ({ data }) => take(data);
    worker.onerror = (event) => give_up(event.message || "its worker does not start");
    worker.postMessage({ open: { ...given.page, bundle: find("bundle").textContent } });
  }
  function give_up(why) {
    worker?.terminate();
    worker = busy = null;
    place.querySelectorAll("input, button").forEach((one) => { one.disabled = true; });
    say(`This browser cannot run the simulation (${why}); the report below is of the recorded run.`, true);
  }
  /** Compute a run with the values as they are; what a run in progress finds is of no use any more. */
  function ask() {
    find("live-command").textContent = command();
    wanted = true;
    if (!moved().length) { // the recorded run is known
      wanted = false;
      if (busy && worker) { worker.terminate(); worker = null; }
      busy = null;
      back();
      return;
    }
    if (worker && busy && (lasts > PATIENCE || performance.now() - busy.since > PATIENCE)) { worker.terminate(); worker = null; }
    if (!worker) { busy = null; begin(); }
    next();
  }
  function next() {
    if (!ready || busy || !wanted) return;
    wanted = false;
    busy = { run: ++number, since: performance.now() };
    worker.postMessage({ run: number, values: { ...values } });
    place.setAttribute("aria-busy", "true");
    say("computing …");
  }
  function take(data) {
    if (data.opened) { ready = true; next(); return; }
    if (!ready) { give_up(data.refused); return; }
    if (!busy || data.run !== busy.run) return;
    lasts = performance.now() - busy.since;
    busy = null;
    place.removeAttribute("aria-busy");
    if (data.refused) say(data.refused, true);
    else show(data);
    next();
  }
  const say = (text, wrong = false) => { said.textContent = text; said.classList.toggle("wrong", wrong); };

  // ---- what a run changes in the page -------------------------------------------------------------

  const MARKS = { passed: "✓", failed: "✗", inconclusive: "?", error: "✗", finished: "●" };
  const whole = (text) => text.replace(/(?<=\d) (?=(?!to\b|on\b|and\b)[\p{L}_]{1,4}(?![\p{L}\d_])|%)/gu, "\u00a0");
  const badge = document.querySelector("header .verdict").parentElement, cards = [...document.querySelectorAll(".cards .card")];
  const tables = { requirements: find("requirements")?.querySelector("table"), results: find("results")?.querySelector("table") };
  const kept = [badge, ...cards, ...Object.values(tables)].filter(Boolean).map((element) => [element, element.innerHTML]);
  const told = (word, text) => make("span", { class: `told ${word}` }, `${MARKS[word]} ${text}`);
  function fill(card, value, note) {
    card.querySelector("b").replaceChildren(value);
    card.querySelector("i")?.remove();
    if (note) card.append(make("i", {}, whole(note)));
  }
  function rows(table, lines) {
    if (!table) return;
    for (const row of [...table.rows].slice(1)) row.remove();
    const body = table.tBodies[0] ?? table;
    body.append(...lines.map((cells) => make("tr", {}, ...cells.map((cell) => make("td", {}, cell)))));
  }
  function show(news) {
    page.report.replace(news.curves, news.arms);
    const [word, reason] = news.verdict;
    badge.replaceChildren(make("span", { class: `verdict ${word}` }, `${MARKS[word]} ${word}`), ` ${reason}`);
    find("live-verdict").replaceChildren(told(word, word));
    const { metrics } = given.page.judged, count = news.required.length;
    news.required.forEach((r, i) => fill(cards[i], told(r.verdict, r.verdict), r.margin ? `margin ${r.margin}` : ""));
    news.cards.forEach(([, value, note], i) => {
      const card = cards.slice(count).find((one) => one.title === metrics[i].name);
      if (card) fill(card, value, note);
    });
    rows(tables.requirements, news.required.map((r) => [told(r.verdict, r.name), r.condition, r.text]));
    rows(tables.results, news.facts);
    state(news.digest, false);
    const changed = moved().length;
    say(`${changed} ${changed === 1 ? "value" : "values"} moved; computed in ${news.seconds < 0.9995 ? `${(1000 * news.seconds).toPrecision(3)} ms` : `${news.seconds.toPrecision(3)} s`}`
      + `${news.failure ? `; the run stops at ${Number.isFinite(news.last) ? page.seconds(Number(news.last.toPrecision(4))) : "its start"}` : ""}`);
  }
  function state(digest, same) {
    find("live-digest").textContent = digest;
    find("live-recorded").textContent = same ? "the recorded run" : digest === given.digest ? "equal to that of the recorded run" : "";
    find("live-note").hidden = same;
    document.body.classList.toggle("moved", !same);
  }
  /** The page as it was written. */
  function back() {
    place.removeAttribute("aria-busy");
    page.report.replace(null, null);
    for (const [element, html] of kept) element.innerHTML = html;
    find("live-verdict").replaceChildren(badge.querySelector(".verdict").cloneNode(true));
    find("live-verdict").firstChild.classList.replace("verdict", "told");
    find("live-command").textContent = given.command;
    state(given.digest, true);
    say("as recorded");
  }

  // ---- values -----------------------------------------------------------------------------------------

  const controls = new Map();
  const tidy = (x) => Number(x.toPrecision(12));
  /** Set a value, and those that have to stay in order with it. */
  function set(key, value) {
    values[key] = value;
    for (const { low, high } of given.ordered) {
      if (key === low && values[high] < value) values[high] = value;
      if (key === high && values[low] > value) values[low] = value;
    }
    for (const [name, { range, field, row, at }] of controls) {
      if (Number(range.value) !== at(values[name])) range.value = String(at(values[name]));
      if (Number(field.value) !== values[name]) field.value = String(values[name]);
      range.setAttribute("aria-valuetext", `${values[name]} ${row.dataset.unit}`);
      row.classList.toggle("moved", values[name] !== recorded[name]);
    }
  }
  const together = () => find("live-together")?.checked;
  /** The same value of the other links, where all are moved together. */
  function alike(key) {
    const { group, label } = given.keys.find((one) => one.key === key);
    if (!together() || !given.links.includes(group)) return [key];
    return given.keys.filter((one) => one.label === label && given.links.includes(one.group)).map((one) => one.key);
  }
  function move(key, value) {
    for (const one of alike(key)) set(one, controls.get(one).inside(value));
    ask();
  }
  /** The slider and the field of a value. Of a value with choices, the slider has the number of one. */
  function control({ key, label, about, unit, value, low, high, step, choices }, number) {
    const id = `live-${number}`, title = `${about ? `${about} ` : ""}${key}`;
    const nearest = (x) => choices.reduce((best, one) => (Math.abs(one - x) < Math.abs(best - x) ? one : best));
    const at = (x) => (choices.length ? choices.indexOf(nearest(x)) : x);
    const least = tidy(value - Math.floor((value - low) / step + 1e-9) * step); // of a grid that has the value
    const ends = choices.length ? { min: 0, max: choices.length - 1, step: 1 } : { min: Math.min(least, value), max: high, step };
    const name = make("label", { for: id, title }, label);
    const range = make("input", { type: "range", id, ...ends, value: at(value) });
    const field = make("input", { type: "number", min: low, max: high, step: "any", value, "aria-label": `${label}${unit ? `, ${unit}` : ""}`, title });
    const row = make("div", { class: "value", "data-key": key, "data-unit": unit }, name, range, make("span", {}, field, ` ${unit}`));
    range.addEventListener("input", () => {
      const found = Number(range.value);
      move(key, choices.length ? choices[found] : Math.abs(found - value) < step / 1e3 ? value : tidy(found));
    });
    field.addEventListener("change", () => {
      const wrong = !field.checkValidity() || field.value === "";
      row.classList.toggle("wrong", wrong);
      if (wrong) say(`${key}: found ${field.value || "nothing"}, expected a number from ${low} to ${high}`, true);
      else move(key, Number(field.value));
    });
    controls.set(key, { range, field, row, at, inside: (x) => (choices.length ? nearest(x) : Math.min(high, Math.max(low, x))) });
    return row;
  }
  const groups = new Map();
  given.keys.forEach((one, i) => {
    if (!groups.has(one.group)) groups.set(one.group, []);
    groups.get(one.group).push(control(one, i));
  });
  const FEW = 9; // lines of a group that is open at first
  const parts = new Map();
  for (const [name, found] of groups) {
    const part = make("details", {}, make("summary", {}, name), ...found);
    parts.set(name, part);
    find("live-values").append(part);
  }
  /** Show the links as one where they move together, and open the first groups. */
  function arrange() {
    given.links.forEach((name, i) => {
      parts.get(name).hidden = together() && i > 0;
      if (!i) parts.get(name).firstChild.textContent = together() ? (given.links.length === 2 ? "both links" : `all ${given.links.length} links`) : name;
    });
    const shown = [...parts.values()].filter((part) => !part.hidden), narrow = matchMedia("(max-width: 820px)").matches;
    shown.forEach((part, i) => { part.open ||= i < (narrow ? 1 : given.open) && part.children.length <= FEW; });
  }
  const same = (label) => new Set(given.keys.filter((one) => given.links.includes(one.group) && one.label === label).map((one) => one.value)).size === 1;
  if (given.links.length > 1 && given.keys.every((one) => !given.links.includes(one.group) || same(one.label))) {
    const box = make("input", { type: "checkbox", id: "live-together" });
    box.checked = true;
    box.addEventListener("change", arrange);
    find("live-choices").append(make("label", {}, box, " move all links together"));
  }
  arrange();
  find("live-reset").addEventListener("click", () => {
    for (const [key, value] of Object.entries(recorded)) set(key, value);
    for (const { row } of controls.values()) row.classList.remove("wrong");
    ask();
  });
  (document.querySelector(".cards") ?? place).after(place);
  place.hidden = false;
  back();
  // Engine and models are compiled while nothing else is to be done.
  const idle = window.requestIdleCallback ?? ((call) => setTimeout(call, 200));
  idle(() => { if (!worker) try { begin(); } catch (error) { give_up(error.message); } });
})();
