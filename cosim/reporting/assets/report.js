/* The moving parts of a report: plots with one cursor, arms, the time bar. Data: the element "data". */
"use strict";
(() => {
  const { find, css, make, svg, bytes, seconds, short } = page;
  const data = JSON.parse(find("data").textContent);
  const begin = data.begin || 0; // s, where the signals and the frames of arms start

  // ---- signals --------------------------------------------------------------------------------

  const decoded = new Map();
  const recorded = new Map(); // {t, y, ends} of signals of which another run is shown
  /** {t, y} of a signal: time in s, and value, null where it is no number. */
  function signal(name) {
    if (!decoded.has(name)) {
      const s = data.signals[name];
      if (data.live) { decoded.set(name, { t: [], y: [] }); return decoded.get(name); }
      const times = s.t !== undefined ? new Float32Array(bytes(s.t)) : Array.from(new Uint32Array(bytes(s.i)), (i) => begin + i * s.dt);
      const values = new Float32Array(bytes(s.y));
      decoded.set(name, {
        t: Array.from(times, (t) => Math.min(t, data.end)),
        y: Array.from(values, (v) => (Number.isFinite(v) ? v : null)),
      });
    }
    return decoded.get(name);
  }

  // ---- plots ----------------------------------------------------------------------------------

  const DASHES = [undefined, [7, 3], [2, 3], [9, 3, 2, 3]];
  const plots = [];
  let time = 0, moving = false, zooming = false;

  function bands(u) {
    const free = [0, 0, 0]; // names of events stand in the first of three rows that is free
    u.ctx.save();
    u.ctx.font = `${10 * devicePixelRatio}px system-ui, sans-serif`;
    u.ctx.textAlign = "left";
    u.ctx.textBaseline = "top";
    for (const event of data.events) {
      const left = u.valToPos(event.t, "x", true);
      const right = u.valToPos(event.to === undefined ? event.t : event.to, "x", true);
      if (right < u.bbox.left || left > u.bbox.left + u.bbox.width) continue;
      const from = Math.max(left, u.bbox.left), to = Math.min(right, u.bbox.left + u.bbox.width);
      u.ctx.fillStyle = css("--fault");
      u.ctx.fillRect(from, u.bbox.top, Math.max(to - from, 2 * devicePixelRatio), u.bbox.height);
      const name = event.label.length > 28 ? `${event.label.slice(0, 27)}…` : event.label;
      const end = from + u.ctx.measureText(name).width + 4 * devicePixelRatio;
      const row = free.findIndex((x) => from >= x);
      if (row < 0 || end > u.bbox.left + u.bbox.width) continue;
      u.ctx.fillStyle = css("--faint");
      u.ctx.fillText(name, from + 3 * devicePixelRatio, u.bbox.top + (2 + 12 * row) * devicePixelRatio);
      free[row] = end;
    }
    u.ctx.restore();
  }
  function references(u, values) {
    u.ctx.save();
    u.ctx.strokeStyle = css("--faint");
    u.ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const value of values) {
      const y = u.valToPos(value, "y", true);
      if (y < u.bbox.top || y > u.bbox.top + u.bbox.height) continue;
      u.ctx.beginPath();
      u.ctx.moveTo(u.bbox.left, y);
      u.ctx.lineTo(u.bbox.left + u.bbox.width, y);
      u.ctx.stroke();
    }
    u.ctx.restore();
  }
  /** The curves of the recorded run, pale, where the page shows another one. */
  function shadows(u) {
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    u.ctx.clip();
    u.ctx.globalAlpha = 0.35;
    u.ctx.lineWidth = 1.6 * devicePixelRatio;
    u.panel.series.forEach((s, i) => {
      const old = recorded.get(s.name);
      if (!old) return;
      u.ctx.strokeStyle = css(`--s${(s.colour ?? i) % 7}`);
      u.ctx.beginPath();
      old.y.forEach((y, k) => { if (y !== null) u.ctx.lineTo(u.valToPos(old.t[k], "x", true), u.valToPos(y, "y", true)); });
      u.ctx.stroke();
    });
    u.ctx.restore();
  }
  /** The least and the greatest value of a curve. */
  const ends = ({ y }) => [Math.min, Math.max].map((most) => y.reduce((a, b) => (b === null ? a : a === null ? b : most(a, b)), null));
  /** Limits of an axis with all values of `panel`; shares start at 0 unless some are below. */
  function range(panel) {
    return (u, low, high) => {
      if (panel.unit === "%" && !(low < 0)) return [0, 1.06 * (high || 1)];
      const before = panel.series.flatMap((s) => recorded.get(s.name)?.ends ?? []), values = [...panel.reference, ...before.filter((y) => y !== null)];
      let a = Math.min(low ?? 0, ...values), b = Math.max(high ?? 1, ...values);
      if (!(b > a)) { const pad = Math.abs(a) * 0.1 || 1; a -= pad; b += pad; }
      const pad = 0.06 * (b - a);
      return [a - pad, b + pad];
    };
  }
  /** The last number up to place i: signals of one panel need not have values at the same times. */
  function before(values, i) {
    while (i > 0 && (values[i] === null || values[i] === undefined)) i--;
    return i === null || i === undefined ? null : values[i];
  }
  /** The columns of a plot. */
  function joined(panel) {
    const tables = panel.series.map((s) => { const { t, y } = signal(s.name); return [t, y]; });
    return tables.length === 1 ? tables[0] : uPlot.join(tables);
  }
  /** Draw a panel into a figure; returns the plot. Values are in the unit that people read times 1 / scale. */
  function draw(panel, place) {
    const shown = (v, digits) => (v === null || v === undefined ? "–" : short(v * (panel.scale ?? 1), digits));
    const axis = { stroke: () => css("--text"), grid: { stroke: () => css("--grid"), width: 1 },
      ticks: { stroke: () => css("--line"), width: 1 }, font: "12px system-ui, sans-serif" };
    const options = {
      width: Math.max(260, place.clientWidth), height: 210,
      scales: { x: { time: false, range: (u, a, b) => [a, b] }, y: { range: range(panel) } },
      cursor: { y: false, sync: { key: "time", setSeries: false }, drag: { x: true, y: false } },
      axes: [{ ...axis, size: 34, space: 70, values: (u, ticks) => ticks.map(seconds) }, { ...axis, size: 62, label: panel.unit, labelSize: 18, labelFont: "12px system-ui, sans-serif",
        values: (u, ticks) => ticks.map((v) => shown(v, 7)) }],
      series: [{ label: "t", value: (u, v) => (v === null || v === undefined ? "–" : `${v.toFixed(3)} s`) },
        ...panel.series.map((s, i) => ({ label: s.label, stroke: () => css(`--s${(s.colour ?? i) % 7}`), width: 1.6,
          dash: DASHES[s.dash ?? Math.floor(panel.series.length > 7 ? i / 7 : i % 4)], spanGaps: true, points: { show: false },
          value: (u, v, series, i) => shown(v ?? before(u.data[series], i), 4) }))],
      hooks: {
        drawClear: [(u) => bands(u), (u) => shadows(u)],
        draw: [(u) => references(u, panel.reference)],
        ready: [(u) => {
          u.over.addEventListener("mousemove", (e) => {
            stop();
            show(u.posToVal(e.clientX - u.over.getBoundingClientRect().left, "x"), u);
          });
          requestAnimationFrame(() => place_cursor(u));
        }],
        setScale: [(u, key) => { if (key === "x") zoom(u); }],
      },
    };
    const plot = new uPlot(options, joined(panel), place);
    plot.panel = panel;
    plots.push(plot);
    return plot;
  }
  function zoom(source) {
    if (zooming) return;
    zooming = true;
    const { min, max } = source.scales.x;
    for (const u of plots) if (u !== source) u.setScale("x", { min, max });
    zooming = false;
  }
  function place_cursor(u) {
    u.setCursor({ left: u.valToPos(time, "x"), top: 1 }, false);
    u.setLegend({ idx: u.valToIdx(time) }, false);
  }
  function figure(panel, parent) {
    const place = make("figure", { "data-panel": panel.title });
    place.append(make("figcaption", {}, panel.title), table(panel));
    parent.append(place);
    const plot = draw(panel, place);
    new ResizeObserver(() => {
      const width = Math.max(260, place.clientWidth);
      if (Math.abs(width - plot.width) <= 1) return;
      plot.setSize({ width, height: 210 });
      queueMicrotask(() => place_cursor(plot)); // after uPlot, which keeps its place in pixels
    }).observe(place);
    return { place, plot };
  }
  /** What a panel shows, for a screen reader. */
  function table(panel) {
    const rows = panel.series.map((s) => {
      const y = signal(s.name).y.filter((v) => v !== null);
      const cells = [s.label, y.reduce((a, b) => Math.min(a, b), Infinity), y.reduce((a, b) => Math.max(a, b), -Infinity), y[y.length - 1]];
      return make("tr", {}, ...cells.map((c) => make("td", {}, typeof c === "string" ? c : short(c * (panel.scale ?? 1), 4))));
    });
    const head = make("tr", {}, ...["signal", "least", "greatest", "last"].map((c) => make("th", {}, c)));
    return make("table", { class: "hidden" }, make("caption", {}, `${panel.title} in ${panel.unit}`), head, ...rows);
  }

  // ---- arms -----------------------------------------------------------------------------------

  const track = (b) => (data.live ? signal(b) : new Float32Array(bytes(b)));
  const LEVEL = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const tracks = data.arms.map((arm) => ({ q: arm.q.map(track), torque: (arm.torque || []).map(track) }));
  const frames = data.arms.map((arm, k) => ({ ...arm, ...tracks[k],
    base: arm.base || { rotation: LEVEL, origin: [0, 0, 0], scale: 1 }, workspace: arm.workspace ?? (arm.planar ? 0 : k), recent: [] }));
  let yaw = -0.6, pitch = 0.4;
  const flat = frames.every((arm) => arm.planar);
  const times = (R, v) => [0, 1, 2].map((r) => R[3 * r] * v[0] + R[3 * r + 1] * v[1] + R[3 * r + 2] * v[2]);
  const product = (A, B) => Array.from({ length: 9 }, (_, k) => { const r = 3 * Math.floor(k / 3), c = k % 3;
    return A[r] * B[c] + A[r + 1] * B[c + 3] + A[r + 2] * B[c + 6]; });
  const add = (a, b) => a.map((x, i) => x + b[i]);
  const less = (a, b) => a.map((x, i) => x - b[i]);
  function at(values, t) {
    if (data.live) return values.y[values.t.findLastIndex((x) => x <= t)] ?? values.y[values.y.length - 1] ?? 0;
    const k = Math.min(Math.max((t - begin) / data.frame, 0), values.length - 1), i = Math.floor(k);
    const next = values[Math.min(i + 1, values.length - 1)];
    return values[i] + (k - i) * (next - values[i]);
  }
  /** Points of an arm in its base frame at positions q: the base, each joint, and the tip. */
  function points(arm, q) {
    let R = LEVEL, p = [0, 0, 0];
    const found = [p];
    arm.joints.forEach((joint, i) => {
      p = add(p, times(R, joint.origin));
      R = product(R, joint.rotation);
      if (joint.prismatic) p = add(p, times(R, [0, 0, q[i]]));
      else R = product(R, [Math.cos(q[i]), -Math.sin(q[i]), 0, Math.sin(q[i]), Math.cos(q[i]), 0, 0, 0, 1]);
      found.push(p);
    });
    found.push(add(p, times(R, arm.tip)));
    return found;
  }
  /** A place of the base of an arm in the coordinates of its workspace. */
  const stand = (arm, p) => times(arm.base.rotation, less(p, arm.base.origin)).map((x) => arm.base.scale * x);
  const placed = (arm, t) => points(arm, arm.q.map((values) => at(values, t)));
  /** Force at the tip of a planar arm of two joints whose joint torques are tau: J^-T tau. */
  function force(where, tau) {
    const [a, b] = [[where[3][0] - where[1][0], where[3][1] - where[1][1]], [where[3][0] - where[2][0], where[3][1] - where[2][1]]];
    const J = [-a[1], a[0], -b[1], b[0]]; // rows: d(tip)/d(q1), d(tip)/d(q2)
    const det = J[0] * J[3] - J[1] * J[2];
    if (Math.abs(det) < 0.05) return null;
    return [(J[3] * tau[0] - J[1] * tau[1]) / det, (-J[2] * tau[0] + J[0] * tau[1]) / det, 0];
  }
  /** Whether the force at the tip can be drawn: of the torques of two joints in a plane. */
  function pulled(arm) { return arm.planar && arm.torque.length === 2 && (data.live || arm.torque.some((tau) => tau.some((v) => v !== 0))); }

  const scene = find("arm");
  const WIDTH = 360, FOOT = 34, SEEN = 60; // pixels: of the picture, and below the arms; times at which all is seen
  const TRACE = 3, PARTS = 6; // s of the path that a tip leaves, and how many times it fades
  let strongest = 1;
  /** The places that the arms of a workspace come to: its middle and how far they are from there. */
  function extent(arms) {
    const all = [];
    for (const arm of arms) {
      for (let k = 0; k <= SEEN && !data.live; k++) all.push(...placed(arm, begin + (k * (data.end - begin)) / SEEN).map((p) => stand(arm, p)));
      if (data.live) for (const s of [-1, 1]) all.push([0, 1, 2].map((i) => s * arm.reach * (flat && i === 2 ? 0 : 1)));
      all.push(stand(arm, [0, 0, 0]));
    }
    const low = [0, 1, 2].map((i) => Math.min(...all.map((p) => p[i]))), high = [0, 1, 2].map((i) => Math.max(...all.map((p) => p[i])));
    const middle = low.map((x, i) => (x + high[i]) / 2), thick = Math.max(...arms.map((arm) => bulk(arm, 0)));
    const wide = Math.max(...all.map((p) => Math.hypot(p[0] - middle[0], p[1] - middle[1])));
    const half = flat ? [(high[0] - low[0]) / 2, (high[1] - low[1]) / 2]
      : [wide, Math.max(...all.map((p) => Math.hypot(...less(p, middle))))];
    return { middle, wide, floor: Math.min(low[2], 0), half: half.map((x) => Math.max(x, 0.05) + 1.6 * thick) };
  }
  /** The radius of the body in front of joint i, m in the workspace. */
  const bulk = (arm, i) => arm.base.scale * arm.reach * (frames.length > 4 ? 0.03 : 0.042) * (1 - (0.5 * i) / (arm.joints.length + 1));
  const spaces = [...new Set(frames.map((arm) => arm.workspace))].map((number) => frames.filter((arm) => arm.workspace === number));
  let extents, columns, rows, half, zoomed, cell, HEIGHT, spacing; // how the workspaces lie in the picture
  function arrange() {
    extents = scene ? spaces.map(extent) : [];
    columns = Math.ceil(Math.sqrt(spaces.length)); rows = Math.ceil(spaces.length / columns);
    half = [0, 1].map((i) => Math.max(...extents.map((x) => x.half[i]), 0.05));
    zoomed = Math.min(WIDTH / columns / (2 * half[0]), WIDTH / rows / (2 * half[1])); // pixels per m
    cell = [WIDTH / columns, Math.max(2 * half[1] * zoomed, (0.5 * WIDTH) / columns)];
    HEIGHT = rows * cell[1] + FOOT;
    spacing = round((0.3 * WIDTH) / columns / zoomed);
    scene?.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT.toFixed(0)}`);
    strongest = 1;
    for (const arm of frames) for (const tau of arm.torque) for (const v of data.live ? [] : tau) strongest = Math.max(strongest, Math.abs(v));
  }
  /** A multiple of 1, 2 or 5 of a power of ten up to a length. */
  function round(length) {
    const power = 10 ** Math.floor(Math.log10(length));
    return [5, 2, 1].find((k) => k * power <= length) * power;
  }
  const metres = (x) => (x < 1 ? `${Number((1000 * x).toPrecision(3))} mm` : `${x} m`);
  /** Pixels right and down, and the distance to the eye, of a place in workspace k. */
  function seen(k, p) {
    const { middle } = extents[k], d = less(p, middle);
    const left = cell[0] * (k % columns + 0.5), top = cell[1] * (Math.floor(k / columns) + 0.5);
    if (flat) return [left + zoomed * d[0], top - zoomed * d[1], -d[2]];
    const x = Math.cos(yaw) * d[0] - Math.sin(yaw) * d[1], y = Math.sin(yaw) * d[0] + Math.cos(yaw) * d[1];
    return [left + zoomed * x, top - zoomed * (Math.cos(pitch) * d[2] + Math.sin(pitch) * y), Math.cos(pitch) * y - Math.sin(pitch) * d[2]];
  }
  const path = (k, places) => places.map((p) => seen(k, p).slice(0, 2).map((x) => x.toFixed(1)).join(",")).join(" ");
  const mixed = (colour, share, other) => `color-mix(in srgb, ${colour} ${share}%, ${other})`;

  /** The ground of workspace k as squares, and lines down to it from bases above it. */
  function ground(k) {
    const { middle, wide, floor } = extents[k], g = svg("g", { class: "ground" });
    const size = flat ? half : [wide, wide], [from, to] = [0, 1].map((s) => [0, 1].map((i) =>
      (s ? Math.ceil : Math.floor)((middle[i] + (s ? 1 : -1) * size[i]) / spacing) * spacing));
    const z = flat ? 0 : floor;
    if (!flat) g.append(svg("polygon", { points: path(k, [[from[0], from[1], z], [to[0], from[1], z], [to[0], to[1], z], [from[0], to[1], z]]), class: "floor" }));
    for (let i = 0; i < 2; i++) {
      const count = Math.round((to[i] - from[i]) / spacing);
      for (let n = 0; n <= count; n++) {
        const ends = [from, to].map((end) => { const p = [end[0], end[1], z]; p[i] = from[i] + n * spacing; return p; });
        g.append(svg("polyline", { points: path(k, ends) }));
      }
    }
    return g;
  }
  /** The scale in the corner, and the directions of the axes. */
  function legend() {
    const g = svg("g", { class: "scale" }), y = HEIGHT - 14, length = spacing * zoomed;
    g.append(svg("path", { d: `M10,${y - 4} V${y} H${10 + length} V${y - 4}`, fill: "none" }));
    const text = svg("text", { x: 16 + length, y: y + 1 });
    text.append(metres(spacing));
    g.append(text);
    const from = [WIDTH - 34, HEIGHT - (flat ? 12 : 18)];
    ["x", "y", "z"].slice(0, flat ? 2 : 3).forEach((name, i) => {
      const p = [0, 1, 2].map((j) => (i === j ? 1 : 0)), [a, b] = [seen(0, extents[0].middle), seen(0, add(extents[0].middle, p))];
      const d = [0, 1].map((j) => (b[j] - a[j]) / zoomed);
      g.append(svg("line", { x1: from[0], y1: from[1], x2: from[0] + 18 * d[0], y2: from[1] + 18 * d[1] }));
      const label = svg("text", { x: from[0] + 25 * d[0], y: from[1] + 25 * d[1] + 4, "text-anchor": "middle" });
      label.append(name);
      if (Math.hypot(...d) > 0.25) g.append(label);
    });
    return g;
  }
  /** The places of a tip up to t, one for each frame of the last TRACE seconds. */
  function recent(arm, t) {
    if (data.live) {
      arm.recent.push([t, stand(arm, placed(arm, t).pop())]);
      arm.recent = arm.recent.filter(([then]) => then > t - TRACE && then <= t);
      return arm.recent.map(([, p]) => p);
    }
    const step = data.frame, first = Math.max(begin, t - TRACE), found = [];
    for (let k = Math.ceil((first - begin) / step); begin + k * step < t; k++) found.push(arm.recent[k] ??= stand(arm, placed(arm, begin + k * step).pop()));
    return [...found, stand(arm, placed(arm, t).pop())];
  }
  arrange();
  if (scene) {
    find("arms").append(...frames.map((arm, k) =>
      make("span", {}, make("b", { style: `color:var(--s${k % 7})` }, k % 2 ? "□" : "■"), ` ${arm.name}`)));
    if (frames.some(pulled)) find("arms").append(make("span", { class: "force" }, make("b", { style: "color:var(--failed)" }, "→"), " force at the tip"));
    find("arms").after(make("p", { class: "arms when", id: "when" }));
    if (!flat) {
      let held = null;
      scene.classList.add("turns");
      scene.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; scene.setPointerCapture(e.pointerId); });
      for (const end of ["pointerup", "pointercancel"]) scene.addEventListener(end, () => { held = null; });
      scene.addEventListener("pointermove", (e) => {
        if (!held) return;
        yaw += (e.clientX - held[0]) * 0.01;
        pitch = Math.min(1.5, Math.max(0, pitch + (e.clientY - held[1]) * 0.01));
        held = [e.clientX, e.clientY];
        arms(time);
      });
    }
  }
  /** The force at a tip as an arrow, null where there is none. */
  function arrow(k, arm, where) {
    const pull = pulled(arm) ? force(where, arm.torque.map((values) => at(values, time))) : null;
    const size = pull ? Math.hypot(...pull) : 0;
    if (!(size > 0.01 * strongest)) return null;
    const scale = (0.5 * arm.reach * Math.min(1, size / strongest)) / size, tip = where[where.length - 1];
    const [from, to] = [tip, add(tip, pull.map((x) => scale * x))].map((p) => seen(k, stand(arm, p)));
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    const wing = (d) => `${to[0] - 8 * Math.cos(angle + d)},${to[1] - 8 * Math.sin(angle + d)}`;
    return svg("path", { d: `M${from.slice(0, 2)} L${to.slice(0, 2)} M${wing(0.45)} L${to.slice(0, 2)} L${wing(-0.45)}`, class: "pull" });
  }
  function arms(t) {
    if (!scene) return;
    const panel = css("--panel"), text = css("--text"), below = [], bodies = [], above = [];
    spaces.forEach((_, k) => below.push(ground(k)));
    frames.forEach((arm, number) => {
      const k = spaces.findIndex((space) => space.includes(arm)), colour = css(`--s${number % 7}`);
      const own = placed(arm, t), where = own.map((p) => stand(arm, p)), places = where.map((p) => seen(k, p));
      const fill = number % 2 ? mixed(colour, 35, panel) : colour, edge = mixed(colour, 70, text);
      const { floor } = extents[k], base = where[0];
      if (!flat) {
        below.push(svg("polyline", { points: path(k, where.map((p) => [p[0], p[1], floor])), class: "shadow", "stroke-width": 2 * zoomed * bulk(arm, 2) }));
        if (base[2] > floor + 0.01) below.push(svg("polyline", { points: path(k, [[base[0], base[1], floor], base]), class: "post" }));
      }
      const trace = recent(arm, t), part = Math.max(1, Math.ceil(trace.length / PARTS));
      for (let i = 0; i + 1 < trace.length; i += part)
        below.push(svg("polyline", { points: path(k, trace.slice(i, i + part + 1)), class: "trace", stroke: colour, "stroke-opacity": (0.15 + (0.75 * i) / trace.length).toFixed(2) }));
      const bodied = (from, to, width, depth) => {
        const ends = { x1: from[0].toFixed(2), y1: from[1].toFixed(2), x2: to[0].toFixed(2), y2: to[1].toFixed(2), "data-arm": arm.name };
        bodies.push([depth, svg("line", { ...ends, stroke: edge, "stroke-width": (width + 2).toFixed(2) }), svg("line", { ...ends, stroke: fill, "stroke-width": width.toFixed(2) })]);
      };
      for (let i = 0; i + 1 < places.length; i++) {
        if (Math.hypot(...less(where[i + 1], where[i])) < 1e-4) continue;
        const width = Math.max(3, 2 * zoomed * bulk(arm, i) * (number % 2 ? 0.6 : 1)); // one of two that meet is seen inside the other
        bodied(places[i], places[i + 1], width, flat ? -number : (places[i][2] + places[i + 1][2]) / 2 - (number % 2) * bulk(arm, i));
      }
      for (const [i, [x, y, depth]] of places.entries()) {
        const tip = i === places.length - 1, r = tip ? 3 : Math.max(1.2, (number % 2 ? 0.25 : 0.4) * zoomed * bulk(arm, i));
        const dot = svg("circle", { cx: x.toFixed(2), cy: y.toFixed(2), r: r.toFixed(2), fill: tip ? colour : panel, stroke: edge });
        if (tip) { dot.setAttribute("data-tip", arm.name); dot.setAttribute("data-at", where[i].map((v) => v.toPrecision(7)).join(" ")); }
        bodies.push([flat ? -number : depth - 2 * bulk(arm, i), dot]);
      }
      const pull = arrow(k, arm, own);
      if (pull) above.push(pull);
    });
    bodies.sort((a, b) => b[0] - a[0]); // the farthest first
    scene.replaceChildren(...below, ...bodies.flatMap(([, ...drawn]) => drawn), ...above, legend());
  }

  // ---- time: the only place where anything moves -------------------------------------------------

  const slider = find("time"), output = find("now"), play = find("play"), speed = find("speed");
  function show(t, source) {
    if (moving) return;
    moving = true;
    time = Math.min(Math.max(t, begin), data.end || t);
    slider.value = String(time);
    output.textContent = `${time.toFixed(3)} s`;
    slider.setAttribute("aria-valuetext", output.textContent);
    for (const u of plots) if (u !== source) place_cursor(u);
    arms(time);
    if (find("when")) find("when").textContent = `at ${output.textContent}`;
    moving = false;
  }
  const remember = () => { try { history.replaceState(null, "", `#t=${time.toFixed(3)}`); } catch { /* not in a sandbox */ } };
  slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
  slider.addEventListener("change", remember);
  let running = 0, last = 0;
  function stop() {
    if (data.live) { follow(false); return; }
    cancelAnimationFrame(running);
    running = 0;
    play.textContent = "▶ Play";
  }
  function advance(now) {
    show(time + ((now - last) / 1000) * Number(speed.value));
    last = now;
    if (time >= data.end) { stop(); remember(); } else running = requestAnimationFrame(advance);
  }
  play.addEventListener("click", () => {
    if (data.live) { follow(!following); return; }
    if (running) { stop(); remember(); return; }
    if (time >= data.end) show(begin);
    play.textContent = "❚❚ Pause";
    last = performance.now();
    running = requestAnimationFrame(advance);
  });
  find("whole").addEventListener("click", () => { for (const u of plots.slice(0, 1)) u.setScale("x", { min: begin, max: data.end }); });

  // ---- another run of the same scenario ---------------------------------------------------------

  /** Show `curves` ({t, y} by signal) and `arms` ({q, torque} of each) of another run; null: the recorded one. */
  function replace(curves, arms) {
    for (const [name, curve] of [...recorded]) { decoded.set(name, curve); recorded.delete(name); }
    for (const [name, { t, y }] of Object.entries(curves ?? {})) {
      recorded.set(name, { ...signal(name), ends: ends(signal(name)) });
      decoded.set(name, { t: Array.from(t, (x) => Math.min(x, data.end)), y: Array.from(y, (v) => (Number.isFinite(v) ? v : null)) });
    }
    frames.forEach((arm, k) => Object.assign(arm, arms?.[k]?.q[0]?.length ? arms[k] : tracks[k], { recent: [] }));
    arrange();
    zooming = true; // each diagram keeps its limits
    for (const u of plots) {
      const { min, max } = u.scales.x;
      u.setData(joined(u.panel), false);
      u.setScale("x", { min, max });
      u.root.parentElement.querySelector("table.hidden").replaceWith(table(u.panel));
    }
    zooming = false;
    show(time);
  }
  if (!data.live) page.report = { replace };

  // ---- small pictures that are laid over each other ---------------------------------------------

  const laid = [];
  let overlay = null;
  function forget({ place, plot }) {
    plots.splice(plots.indexOf(plot), 1);
    plot.destroy();
    place.remove();
  }
  function lay() {
    if (overlay) forget(overlay);
    const series = laid.flatMap((button, colour) => button.dataset.signals.split("|").map((name, dash) => (
      { name, colour, dash: dash % 4, label: `${button.dataset.label}: ${data.signals[name].label}` })));
    const reference = JSON.parse(find("overlay").dataset.reference);
    overlay = series.length ? figure({ title: "Chosen runs", unit: data.signals[series[0].name].unit, scale: data.signals[series[0].name].scale, reference, series }, find("overlay")) : null;
    show(time);
  }
  for (const button of document.querySelectorAll("button[data-signals]")) {
    if (button.getAttribute("aria-pressed") === "true") laid.push(button);
    button.addEventListener("click", () => {
      const at = laid.indexOf(button);
      if (at < 0) laid.push(button); else laid.splice(at, 1);
      button.setAttribute("aria-pressed", String(at < 0));
      lay();
    });
  }

  // ---- choice of signals, start ---------------------------------------------------------

  const chosen = new Map();
  function choose(name, on) {
    if (on) chosen.set(name, figure({ title: name, unit: data.signals[name].unit, scale: data.signals[name].scale, reference: [], series: [{ name, label: name }] }, find("chosen")));
    else {
      forget(chosen.get(name));
      chosen.delete(name);
    }
    show(time);
  }
  const list = find("signals");
  if (list) {
    for (const name of Object.keys(data.signals)) {
      const box = make("input", { type: "checkbox" });
      box.addEventListener("change", () => choose(name, box.checked));
      list.append(make("label", { title: name }, box, ` ${name}${data.signals[name].unit ? ` [${data.signals[name].unit}]` : ""}`));
    }
    find("filter").addEventListener("input", (e) => {
      for (const label of list.children) label.hidden = !label.title.toLowerCase().includes(e.target.value.toLowerCase());
    });
  }
  // Paper is narrow, and shows the end of a run and all that is folded.
  const PAPER = 700;
  let before_print = null;
  addEventListener("beforeprint", () => {
    before_print = { time, widths: plots.map((u) => u.width), closed: [...document.querySelectorAll("details:not([open]):not(#chooser)")] };
    for (const part of before_print.closed) part.open = true;
    for (const u of plots) u.setSize({ width: PAPER, height: 210 });
    if (time === begin) show(data.end);
  });
  addEventListener("afterprint", () => {
    for (const part of before_print.closed) part.open = false;
    plots.forEach((u, i) => u.setSize({ width: before_print.widths[i], height: 210 }));
    show(before_print.time);
  });
  page.repaint(() => { for (const u of plots) u.redraw(false, true); arms(time); });
  for (const panel of data.panels) figure(panel, find(panel.place || "panels"));
  // ---- values that come while a run goes on --------------------------------------------------------

  const WINDOW = 30; // s
  let following = Boolean(data.live);
  function follow(on) {
    following = on;
    play.textContent = on ? "❚❚ Pause" : "▶ Follow";
  }
  function take(news) {
    for (const [name, y] of Object.entries(news.signals)) {
      const s = signal(name), known = s.t[s.t.length - 1] ?? -Infinity;
      const first = news.t.findIndex((t) => t > known);
      if (first < 0) continue;
      s.t.push(...news.t.slice(first));
      s.y.push(...y.slice(first));
      const old = s.t.findIndex((t) => t > news.now - WINDOW - 5);
      if (old > 0) { s.t.splice(0, old); s.y.splice(0, old); }
    }
    const place = find("status");
    place.replaceChildren(make("p", {}, news.head), ...news.tables.map(({ title, head, rows, marked }) => {
      const lines = rows.map((row, i) => make("tr", marked.includes(i) ? { class: "marked" } : {}, ...row.map((c) => make("td", {}, c))));
      return make("div", { class: "scroll" }, make("h3", {}, title), make("table", {}, make("tr", {}, ...head.map((c) => make("th", {}, c))), ...lines));
    }));
    if (following) move(news.now);
    if (news.ended) report(60);
  }
  function move(now) {
    zooming = true; // each diagram gets its limits here
    for (const u of plots) {
      u.setData([signal(u.panel.series[0].name).t, ...u.panel.series.map((s) => signal(s.name).y)], false);
      u.setScale("x", { min: Math.max(0, now - WINDOW), max: Math.max(now, 1) });
    }
    zooming = false;
    show(now);
  }
  /** The report of the run, as soon as it is written. */
  async function report(left) {
    source.close();
    const answer = await fetch("report");
    if (answer.status === 200) location.assign("report");
    else if (left > 0) setTimeout(() => report(left - 1), 1000);
  }
  const source = data.live ? new EventSource(data.live) : null;
  if (source) {
    follow(true);
    speed.hidden = true;
    find("whole").hidden = true;
    source.onmessage = (event) => take(JSON.parse(event.data));
  }

  const wanted = /^#t=(-?[\d.]+)$/.exec(location.hash);
  slider.min = String(begin);
  slider.max = String(data.end);
  slider.step = String((data.end - begin) / 2000);
  show(wanted ? Number(wanted[1]) : data.start);
  if (laid.length) lay();
  document.body.dataset.ready = "yes";
})();
