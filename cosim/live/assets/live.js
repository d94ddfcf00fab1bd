/* A live report: values that can be moved, and the run that a worker computes with them. The page has
   the elements "live" (hidden until it is sure to work), "live-data", "bundle" and "live-worker". */
"use strict";
(() => {
  const { find, make, live } = page;
  const place = find("live");
  if (!place || !live.able || !page.report) return;
  const given = JSON.parse(find("live-data").textContent), said = find("live-said");
  const recorded = Object.fromEntries(given.keys.map(({ key, value }) => [key, value]));
  const values = { ...recorded };
  const moved = () => Object.keys(values).filter((key) => values[key] !== recorded[key]);

  // ---- the command that gives this run ------------------------------------------------------------

  /** The setting that gives a value; of what is not in the file, the whole list or table is set. */
  function setting(key) {
    const [path, parts] = Object.entries(given.added).find(([, some]) => some.includes(key)) ?? [key, [key]];
    return `${path}=${parts.map((one) => values[one] ?? one).join("")}`;
  }
  const command = () => live.command(given.command, [...new Set(moved().map(setting))]);

  // ---- the worker: the newest values win --------------------------------------------------------------

  const PATIENCE = 1000; // ms after which a run with old values is given up
  let worker = null, ready = false, busy = null, wanted = false, number = 0, lasts = 0;
  function begin() {
    worker = live.worker(["engine", "measure", "worker"], take, give_up);
    ready = false;
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
  /** Set a value, and those that have to stay in order with it. */
  function set(key, value) {
    values[key] = value;
    for (const { low, high } of given.ordered) {
      if (key === low && values[high] < value) values[high] = value;
      if (key === high && values[low] > value) values[low] = value;
    }
    for (const [name, { show }] of controls) show(values[name], values[name] !== recorded[name]);
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
  function control(one, number) {
    const { key } = one;
    const found = live.slider(number, one, (value) => move(key, value), (text) => say(`${key}: ${text}`, true));
    found.row.dataset.key = key;
    controls.set(key, found);
    return found.row;
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
  live.idle(() => { if (!worker) try { begin(); } catch (error) { give_up(error.message); } });
})();
