/* The runs of a study: a map or points of any two columns, parallel axes that filter, and a table. Data: "points". */
"use strict";
(() => {
  const { find, css, make, bytes, short } = page;
  const data = JSON.parse(find("points").textContent);
  const count = data.count;
  const ROWS = 200, GRID = 60, LINES = 12, WRITTEN = 150;

  // ---- columns --------------------------------------------------------------------------------

  const columns = data.columns.map((c) => {
    const values = c.labels ? new Uint16Array(bytes(c.values)) : new Float32Array(bytes(c.values));
    const distinct = [...new Set(values)].filter((v) => !Number.isNaN(v)).sort((a, b) => a - b);
    const finite = distinct.filter(Number.isFinite);
    const low = finite[0], high = finite[finite.length - 1];
    const log = !c.labels && low > 0 && high / low >= 50 && finite[Math.floor(finite.length / 2)] < 0.3 * (low + high);
    return { ...c, values, distinct, low, high, log, limits: [-Infinity, Infinity] };
  });
  const named = new Map(columns.map((c) => [c.name, c]));
  const title = (c) => (c.unit && c.unit !== "1" ? `${c.name} [${c.unit}]` : c.name);
  const text = (c, v) => (c.labels ? c.labels[v] : Number.isNaN(v) ? "–" : v === Infinity ? "never" : short(v));
  /** Where a value is between the least (0) and the greatest (1) of its column; "never" is above; null: none. */
  function share(c, v) {
    if (Number.isNaN(v)) return null;
    if (v === Infinity) return 1.08;
    if (!(c.high > c.low)) return 0.5;
    return c.log ? Math.log(v / c.low) / Math.log(c.high / c.low) : (v - c.low) / (c.high - c.low);
  }
  /** Values at which an axis has a mark. */
  function ticks(c) {
    if (c.labels || c.distinct.length <= LINES) return c.distinct.filter(Number.isFinite);
    if (c.log) {
      const found = [];
      for (let e = Math.floor(Math.log10(c.low)); 10 ** e <= c.high * 1.0001; e++) if (10 ** e >= c.low * 0.9999) found.push(10 ** e);
      return found.length > 1 ? found : [c.low, c.high];
    }
    const rough = (c.high - c.low) / 5, power = 10 ** Math.floor(Math.log10(rough || 1));
    const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough) || 1;
    const found = [];
    for (let v = Math.ceil(c.low / step) * step; v <= c.high + step * 1e-9; v += step) found.push(Math.abs(v) < step * 1e-9 ? 0 : v);
    return found;
  }

  // ---- colours --------------------------------------------------------------------------------

  const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // viridis
  function colour(s) {
    const x = Math.min(Math.max(s, 0), 1) * (STOPS.length - 1), i = Math.min(Math.floor(x), STOPS.length - 2);
    return STOPS[i].map((a, k) => Math.round(a + (x - i) * (STOPS[i + 1][k] - a)));
  }
  const paint = (s) => (s === null || s > 1.01 ? css("--line") : `rgb(${colour(s).join(",")})`);
  /** The colour of a run: few values have colours of their own. */
  const tint = (c, v) => (c.distinct.length <= 7 ? css(`--s${Math.max(0, c.distinct.indexOf(v))}`) : paint(share(c, v)));

  // ---- what is shown --------------------------------------------------------------------------

  const REDUCE = {
    mean: (v) => v.reduce((a, b) => a + b, 0) / v.length,
    median: (v) => [...v].sort((a, b) => a - b)[Math.floor(v.length / 2)],
    min: (v) => v.reduce((a, b) => Math.min(a, b), Infinity),
    max: (v) => v.reduce((a, b) => Math.max(a, b), -Infinity),
  };
  const state = { x: "", y: "", z: "", reduce: "mean", picked: null, sorted: null, rising: true };
  const passes = (i) => columns.every((c) => {
    const [low, high] = c.limits;
    return (low === -Infinity && high === Infinity) || (c.values[i] >= low && c.values[i] <= high);
  });
  let shown = [];
  function filter() {
    shown = [];
    for (let i = 0; i < count; i++) if (passes(i)) shown.push(i);
  }
  const reduced = (c, rows) => {
    const values = rows.map((i) => c.values[i]).filter((v) => !Number.isNaN(v));
    return values.length ? REDUCE[state.reduce](values) : NaN;
  };
  /** Rows by a key, in order of appearance. */
  function grouped(rows, key) {
    const found = new Map();
    for (const i of rows) { const k = key(i); if (!found.has(k)) found.set(k, []); found.get(k).push(i); }
    return found;
  }

  // ---- canvas ---------------------------------------------------------------------------------

  function begin(canvas, height) {
    const scale = devicePixelRatio || 1, width = canvas.parentElement.clientWidth;
    canvas.style.height = `${height}px`;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    const g = canvas.getContext("2d");
    g.setTransform(scale, 0, 0, scale, 0, 0);
    g.clearRect(0, 0, width, height);
    g.font = "12px system-ui, sans-serif";
    return { g, width, height };
  }
  function write(g, words, x, y, align = "center", faint = false) {
    g.fillStyle = css(faint ? "--faint" : "--text");
    g.textAlign = align;
    g.textBaseline = "middle";
    g.fillText(words, x, y);
  }

  // ---- map ------------------------------------------------------------------------------------

  const map = find("map"), said = find("said");
  let places = []; // where rows are drawn: {x, y, r, rows} or {x, y, w, h, rows}
  function drawMap() {
    const [x, y, z] = [named.get(state.x), named.get(state.y), named.get(state.z)];
    const { g, width, height } = begin(map, 430);
    const box = { left: 74, top: 14, right: width - 96, bottom: height - 46 };
    places = [];
    const listed = (c) => c.axis && c.distinct.length <= GRID;
    const cells = listed(x) && listed(y) && x !== y;
    const across = (c, v, from, to) => from + (cells
      ? ((c.distinct.indexOf(v) + 0.5) / c.distinct.length) * (to - from)
      : (0.04 + 0.88 * share(c, v)) * (to - from));
    const px = (v) => across(x, v, box.left, box.right), py = (v) => across(y, v, box.bottom, box.top);
    if (cells) drawCells(g, box, x, y, z, px, py);
    else drawPoints(g, x, y, z, px, py);
    g.strokeStyle = css("--line");
    g.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    const marks = (c) => (cells ? c.distinct : ticks(c));
    const every = (c, room, size) => Math.max(1, Math.ceil((marks(c).length * size) / room));
    marks(x).forEach((v, k) => { if (k % every(x, box.right - box.left, 46) === 0) write(g, text(x, v), px(v), box.bottom + 13, "center", true); });
    marks(y).forEach((v, k) => { if (k % every(y, box.bottom - box.top, 16) === 0) write(g, text(y, v), box.left - 7, py(v), "right", true); });
    if (!cells && y.distinct.includes(Infinity)) write(g, "never", box.left - 7, py(Infinity), "right", true);
    if (!cells && x.distinct.includes(Infinity)) write(g, "never", px(Infinity), box.bottom + 13, "center", true);
    write(g, title(x), (box.left + box.right) / 2, height - 12);
    g.save();
    g.translate(13, (box.top + box.bottom) / 2);
    g.rotate(-Math.PI / 2);
    write(g, title(y), 0, 0);
    g.restore();
    drawBar(g, box, z, cells);
  }
  function drawCells(g, box, x, y, z, px, py) {
    const w = (box.right - box.left) / x.distinct.length, h = (box.bottom - box.top) / y.distinct.length;
    const groups = grouped(shown, (i) => `${x.values[i]} ${y.values[i]}`);
    for (const rows of groups.values()) {
      const left = px(x.values[rows[0]]) - w / 2, top = py(y.values[rows[0]]) - h / 2;
      const value = reduced(z, rows), s = share(z, value);
      g.fillStyle = paint(s);
      g.fillRect(left, top, w + 0.5, h + 0.5);
      places.push({ x: left, y: top, w, h, rows, value });
      if (groups.size > WRITTEN || w < 34 || h < 13) continue;
      const [red, green, blue] = s === null || s > 1.01 ? [255, 255, 255] : colour(s);
      g.fillStyle = s === null || s > 1.01 ? css("--text") : 0.3 * red + 0.59 * green + 0.11 * blue > 130 ? "#000" : "#fff";
      g.textAlign = "center";
      g.textBaseline = "middle";
      g.fillText(z.labels ? "" : text(z, value), left + w / 2, top + h / 2);
    }
  }
  function drawPoints(g, x, y, z, px, py) {
    if (x.axis && z.axis && !y.axis && z.distinct.length <= LINES && z !== x) drawLines(g, x, y, z, px, py);
    const r = count > 3000 ? 1.6 : count > 300 ? 2.4 : 4;
    for (const i of shown) {
      if (share(x, x.values[i]) === null || share(y, y.values[i]) === null) continue;
      const cx = px(x.values[i]), cy = py(y.values[i]);
      g.fillStyle = tint(z, z.values[i]);
      g.beginPath();
      g.arc(cx, cy, r, 0, 7);
      g.fill();
      places.push({ x: cx, y: cy, r, rows: [i], value: z.values[i] });
    }
  }
  function drawLines(g, x, y, z, px, py) {
    for (const [v, rows] of grouped(shown, (i) => z.values[i])) {
      g.setLineDash([[], [7, 3], [2, 3], [9, 3, 2, 3]][z.distinct.indexOf(v) % 4]);
      const points = [...grouped(rows, (i) => x.values[i])].map(([at, some]) => [at, reduced(y, some)])
        .filter(([at, value]) => Number.isFinite(value) && Number.isFinite(at)).sort((a, b) => a[0] - b[0]);
      g.strokeStyle = tint(z, v);
      g.lineWidth = 1.8;
      g.beginPath();
      points.forEach(([at, value], k) => (k ? g.lineTo(px(at), py(value)) : g.moveTo(px(at), py(value))));
      g.stroke();
    }
    g.lineWidth = 1;
    g.setLineDash([]);
  }
  function drawBar(g, box, z, cells) {
    const x = box.right + 16, top = box.top + 22, bottom = box.bottom - 8;
    if (z.labels || (!cells && z.distinct.length <= 7)) { // values apart, each with its colour
      z.distinct.forEach((v, k) => {
        g.fillStyle = cells ? paint(share(z, v)) : tint(z, v);
        g.fillRect(x, top + 20 * k, 14, 14);
        write(g, text(z, v).slice(0, 10), x + 19, top + 20 * k + 7, "left", true);
      });
    } else {
      for (let k = 0; k < 100; k++) { g.fillStyle = paint(k / 99); g.fillRect(x, bottom - ((k + 1) * (bottom - top)) / 100, 14, (bottom - top) / 100 + 0.5); }
      for (const v of ticks(z)) write(g, short(v), x + 19, bottom - share(z, v) * (bottom - top), "left", true);
    }
    write(g, z.name.slice(0, 15), x, box.top + 6, "left");
  }
  function under(event) {
    const box = map.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    const inside = (p) => (p.w ? x >= p.x && x < p.x + p.w && y >= p.y && y < p.y + p.h : Math.hypot(x - p.x, y - p.y) < p.r + 4);
    return places.findLast(inside);
  }
  map.addEventListener("mousemove", (event) => {
    const place = under(event);
    if (!place) { said.textContent = ""; return; }
    const [x, y, z] = [named.get(state.x), named.get(state.y), named.get(state.z)], i = place.rows[0];
    const many = place.rows.length > 1 ? `, ${state.reduce} of ${place.rows.length} runs` : "";
    said.textContent = `${x.name} ${text(x, x.values[i])}, ${y.name} ${text(y, y.values[i])}: ${z.name} ${text(z, place.value)}${many}`;
  });
  map.addEventListener("click", (event) => {
    const place = under(event);
    state.picked = place ? new Set(place.rows) : null;
    if (place) repeat(place.rows[0]);
    list();
  });

  // ---- parallel axes --------------------------------------------------------------------------

  const fan = find("fan"), limits = find("limits");
  const beside = columns.filter((c) => c.parallel);
  const stable = named.get("stable");
  const place = (k, width) => 60 + (k * (width - 120)) / Math.max(1, beside.length - 1);
  const level = (s, height) => height - 22 - (height - 86) * (s / 1.08);
  function drawFan() {
    const { g, width, height } = begin(fan, 270);
    const mark = (rows, kept) => {
      for (const i of rows) {
        const good = !stable || stable.values[i] === 1;
        g.strokeStyle = css(kept ? (good ? "--s0" : "--s1") : "--grid");
        g.setLineDash(good ? [] : [5, 3]);
        g.beginPath();
        let open = false;
        beside.forEach((c, k) => {
          const s = share(c, c.values[i]);
          if (s === null) { open = false; return; }
          if (open) g.lineTo(place(k, width), level(s, height)); else g.moveTo(place(k, width), level(s, height));
          open = true;
        });
        g.stroke();
      }
    };
    g.globalAlpha = Math.min(1, Math.max(0.08, 60 / count));
    const kept = new Set(shown);
    if (kept.size < count) mark(Array.from({ length: count }, (_, i) => i).filter((i) => !kept.has(i)), false);
    g.globalAlpha = Math.min(1, Math.max(0.08, 60 / Math.max(1, kept.size)));
    mark(shown, true);
    g.globalAlpha = 1;
    g.setLineDash([]);
    beside.forEach((c, k) => {
      const x = place(k, width);
      g.strokeStyle = css("--text");
      g.beginPath();
      g.moveTo(x, level(0, height));
      g.lineTo(x, level(1, height));
      g.stroke();
      write(g, title(c).slice(0, 20), x, k % 2 ? 24 : 10);
      if (c.labels) for (const v of c.distinct) write(g, text(c, v), x + 4, level(share(c, v), height), "left", true);
      else if (c.high > c.low) { write(g, short(c.high), x, 44, "center", true); write(g, short(c.low), x, height - 9, "center", true); }
      else if (c.distinct.length) write(g, text(c, c.distinct[0]), x, height - 9, "center", true);
      if (c.distinct.includes(Infinity)) write(g, "never", x + 4, level(1.08, height), "left", true);
      const [low, high] = c.limits;
      if (low === -Infinity && high === Infinity) return;
      const [a, b] = [Math.max(low, c.low), Math.min(high, c.distinct[c.distinct.length - 1])].map((v) => level(share(c, v), height));
      g.fillStyle = css("--fault");
      g.fillRect(x - 7, b - 2, 14, a - b + 4);
    });
  }
  /** The value of a column at a share of its axis. */
  const at = (c, s) => (s > 1.04 ? Infinity : c.log ? c.low * (c.high / c.low) ** s : c.low + s * (c.high - c.low));
  let dragged = null;
  function grab(event) {
    const box = fan.getBoundingClientRect(), x = event.clientX - box.left;
    const k = beside.map((_, n) => Math.abs(place(n, box.width) - x)).reduce((best, d, n, all) => (d < all[best] ? n : best), 0);
    const s = ((box.height - 22 - (event.clientY - box.top)) / (box.height - 86)) * 1.08;
    return { column: beside[k], s };
  }
  fan.addEventListener("pointerdown", (event) => { dragged = grab(event); fan.setPointerCapture(event.pointerId); });
  fan.addEventListener("pointerup", (event) => {
    if (!dragged) return;
    const { column, s } = dragged, end = grab(event).s;
    dragged = null;
    const small = Math.abs(end - s) < 0.02;
    limit(column, small ? [-Infinity, Infinity] : [at(column, Math.min(s, end)), at(column, Math.max(s, end))]);
  });
  function limit(c, [low, high]) {
    c.limits = [low, high];
    const [from, to] = c.inputs;
    from.value = Number.isFinite(low) ? String(Number(low.toPrecision(5))) : "";
    to.value = Number.isFinite(high) ? String(Number(high.toPrecision(5))) : "";
    state.picked = null;
    refresh();
  }
  for (const c of beside) {
    const input = (what) => make("input", { type: "number", step: "any", "aria-label": `${c.name}: ${what}`, placeholder: what });
    c.inputs = [input("least"), input("greatest")];
    for (const element of c.inputs) element.addEventListener("change", () => {
      const [a, b] = c.inputs.map((e) => e.value);
      c.limits = [a === "" ? -Infinity : Number(a), b === "" ? Infinity : Number(b)];
      state.picked = null;
      refresh();
    });
    limits.append(make("div", {}, make("span", {}, c.name), ...c.inputs));
  }
  find("all").addEventListener("click", () => {
    for (const c of beside) { c.limits = [-Infinity, Infinity]; for (const e of c.inputs) e.value = ""; }
    state.picked = null;
    refresh();
  });

  // ---- the command or the folder of a run -----------------------------------------------------

  const settings = (data.settings || []).map((s) => ({ ...s, index: new Uint16Array(bytes(s.index)) }));
  const quoted = (words) => (/^[\w@%+=:,./-]+$/.test(words) ? words : `'${words.replaceAll("'", "'\\''")}'`);
  const run = (i) => [data.command, ...settings.map((s) => `--set ${quoted(s.start + s.ends[s.index[i]])}`)].join(" ");
  function repeat(i) {
    if (!data.command) return;
    find("one").textContent = run(i);
    find("chosen-run").hidden = false;
  }

  // ---- table ----------------------------------------------------------------------------------

  const rows = find("rows"), listed = columns.filter((c) => c.listed);
  function list() {
    let found = state.picked ? shown.filter((i) => state.picked.has(i)) : [...shown];
    const by = named.get(state.sorted), sign = state.rising ? 1 : -1;
    if (by) found.sort((a, b) => {
      const [u, v] = [by.values[a], by.values[b]];
      return Number.isNaN(u) ? 1 : Number.isNaN(v) ? -1 : u === v ? a - b : sign * (u - v);
    });
    const head = make("tr", {}, make("th"), ...listed.map((c) => {
      const button = make("button", {}, title(c) + (by === c ? (state.rising ? " ▲" : " ▼") : ""));
      button.addEventListener("click", () => { state.rising = state.sorted === c.name ? !state.rising : true; state.sorted = c.name; list(); });
      return make("th", { class: "number", "aria-sort": by === c ? (state.rising ? "ascending" : "descending") : "none" }, button);
    }), make("th", {}, "why"), make("th"));
    rows.replaceChildren(head, ...found.slice(0, ROWS).map(row));
    const more = found.length > ROWS ? `; the first ${ROWS} are listed` : "";
    find("count").textContent = `${found.length} of ${count} runs${more}`;
  }
  function row(i) {
    const why = data.reasons ? data.reasons[data.why[i]] : "";
    const good = !stable || stable.values[i] === 1;
    const cells = [make("td", {}, good ? "✓ stable" : why ? "✗ stopped" : "✗ not stable"),
      ...listed.map((c) => make("td", { class: "number" }, text(c, c.values[i]))), make("td", {}, why)];
    const last = make("td");
    if (data.folders) last.append(make("a", { href: `runs/${data.folders[i]}/` }, "folder"));
    else if (data.command) {
      const button = make("button", {}, "command");
      button.addEventListener("click", () => { repeat(i); find("one").scrollIntoView({ block: "center" }); });
      last.append(button);
    }
    return make("tr", {}, ...cells, last);
  }

  // ---- start ----------------------------------------------------------------------------------

  function refresh() { filter(); drawMap(); drawFan(); list(); }
  const choices = { x: find("map-x"), y: find("map-y"), z: find("map-z"), reduce: find("map-reduce") };
  for (const key of ["x", "y", "z"]) choices[key].append(...columns.map((c) => make("option", { value: c.name }, title(c))));
  function view(v) {
    Object.assign(state, { x: v.x, y: v.y, z: v.z, reduce: v.reduce });
    for (const [key, element] of Object.entries(choices)) element.value = state[key];
    drawMap();
  }
  for (const [key, element] of Object.entries(choices)) element.addEventListener("change", () => { state[key] = element.value; drawMap(); });
  for (const v of data.views) {
    const button = make("button", {}, v.title);
    button.addEventListener("click", () => view(v));
    find("views").append(button);
  }
  filter();
  view(data.views[0]);
  refresh();
  let width = map.parentElement.clientWidth;
  new ResizeObserver(() => {
    if (map.parentElement.clientWidth === width) return;
    width = map.parentElement.clientWidth;
    drawMap();
    drawFan();
  }).observe(map.parentElement);
  page.repaint(() => { drawMap(); drawFan(); });
  document.body.dataset.ready = "yes";
})();
