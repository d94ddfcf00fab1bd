/* engine.js: computes a run of a scenario in a page, a worker or Node, with the bits of the command line.
 *
 * `const live = await Live.open(bundle)` loads a bundle of cosim.live: the engine and the models as
 * WebAssembly, and an image of the plan. `live.compute({key: value, ...}, progress)` computes the run. There
 * is no DOM and no network here.
 */
"use strict";
const Live = (() => {
  const RUN_OK = 0, RUN_STEP = 2, RUN_SET = 3, RUN_GET = 4, RUN_NOT_FINITE = 5, RUN_HISTORY = 6,
    RUN_TERMINATED = 7, RUN_EARLY_RETURN = 8, RUN_ENDED = 14;
  const START_DONE = 0, START_OTHER = 1, START_REFUSED = 2, START_CHANGED = 4;
  const STAGE_ENTER = 0, STAGE_LEAVE = 2;
  const STATUS = ["ok", "warning", "discard", "error", "fatal", "pending"];
  const CHUNK_TICKS = 8192, CHUNK_VALUES = 1 << 15;

  /* ---- bytes ---------------------------------------------------------------------------------- */

  /** Bytes of a text in base64. */
  function bytes(text) {
    if (typeof Buffer !== "undefined") return Uint8Array.from(Buffer.from(text, "base64"));
    const raw = atob(text), found = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) found[i] = raw.charCodeAt(i);
    return found;
  }

  /** A block of the bundle: base64 of what zlib has compressed. */
  async function block(text) {
    const packed = new Blob([bytes(text)]).stream();
    const plain = packed.pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(plain).arrayBuffer());
  }

  async function numbers(text, Kind) {
    return new Kind((await block(text)).buffer);
  }

  /* ---- modules: DynamicLinking.md of the WebAssembly tool conventions ------------------------- */

  function unsigned(data, at) {
    let value = 0, shift = 0, byte;
    do {
      byte = data[at.i++];
      value |= (byte & 127) << shift;
      shift += 7;
    } while (byte & 128);
    return value;
  }

  /** The memory and the table entries that a library needs: section dylink.0. */
  function needs(module) {
    const [section] = WebAssembly.Module.customSections(module, "dylink.0");
    const data = new Uint8Array(section), at = {i: 0};
    while (at.i < data.length) {
      const kind = data[at.i++], size = unsigned(data, at), end = at.i + size;
      if (kind === 1) {
        const [memory, align, table] = [0, 0, 0].map(() => unsigned(data, at));
        return {memory, align: 1 << align, table};
      }
      at.i = end;
    }
    return {memory: 0, align: 1, table: 0};
  }

  /** Imports of a module: the functions that `given` has; any other one ends the run when called. */
  function imports(module, given) {
    const found = {};
    for (const {module: from, name, kind} of WebAssembly.Module.imports(module)) {
      const value = given[name];
      if (value === undefined && kind !== "function") throw new Error(`${from}.${name} is missing`);
      (found[from] ??= {})[name] = value ?? (() => {
        throw new Error(`${name} was called, which a page does not have`);
      });
    }
    return found;
  }

  /** The engine with its memory, and the libraries of the models in it. */
  class Machine {
    static async open(engine, modules) {
      const machine = new Machine();
      const core = await WebAssembly.compile(await block(engine));
      machine.core = (await WebAssembly.instantiate(core, imports(core, {}))).exports;
      machine.core._initialize?.();
      machine.memory = machine.core.memory;
      machine.table = machine.core.__indirect_function_table;
      machine.places = new Map();
      machine.modules = {};
      for (const [name, text] of Object.entries(modules)) {
        machine.modules[name] = await machine.library(await block(text));
      }
      return machine;
    }

    async library(code) {
      const module = await WebAssembly.compile(code), {memory, align, table} = needs(module);
      const room = this.reserve(memory + align), base = Math.ceil(room / align) * align;
      const constant = (value) => new WebAssembly.Global({value: "i32"}, value);
      const given = {
        ...this.core,
        __memory_base: constant(base),
        __table_base: constant(this.table.grow(table)),
      };
      const found = (await WebAssembly.instantiate(module, imports(module, given))).exports;
      found.__wasm_apply_data_relocs?.();
      found.__wasm_call_ctors?.();
      return found;
    }

    /** Zeroed memory. */
    reserve(size) {
      const at = this.core.calloc(1, Math.max(8, size));
      if (!at) throw new Error(`no memory for ${size} bytes`);
      return at;
    }

    get view() {
      const buffer = this.memory.buffer;
      if (this._view?.buffer !== buffer) this._view = new DataView(buffer);
      return this._view;
    }

    get bytes() {
      return new Uint8Array(this.memory.buffer);
    }

    doubles(at, count) {
      return new Float64Array(this.memory.buffer, at, count);
    }

    text(string) {
      const coded = new TextEncoder().encode(string + "\0"), at = this.reserve(coded.length);
      this.bytes.set(coded, at);
      return at;
    }

    read(at) {
      const all = this.bytes;
      return new TextDecoder().decode(all.subarray(at, all.indexOf(0, at)));
    }

    /** The place of a function in the table, by which C calls it. */
    index(call) {
      if (!this.places.has(call)) {
        const at = this.table.grow(1);
        this.table.set(at, call);
        this.places.set(call, at);
      }
      return this.places.get(call);
    }
  }

  /* ---- numbers as Python prints them ---------------------------------------------------------- */

  /** A number with six significant digits, as "%.6g". */
  function short(x) {
    if (!Number.isFinite(x)) return repr(x);
    const power = x === 0 ? 0 : Math.floor(Math.log10(Math.abs(Number(x.toPrecision(6)))));
    const cut = (text) => text.includes(".") ? text.replace(/\.?0+$/, "") : text;
    if (power >= -4 && power < 6) return cut(x.toPrecision(6));
    const [digits, e] = x.toExponential(5).split("e");
    return `${cut(digits)}e${e[0]}${e.slice(1).padStart(2, "0")}`;
  }

  function repr(x) {
    if (Number.isNaN(x)) return "nan";
    if (!Number.isFinite(x)) return x > 0 ? "inf" : "-inf";
    return Number.isInteger(x) ? x.toFixed(1) : String(x);
  }

  /* ---- runs ----------------------------------------------------------------------------------- */

  class Failure extends Error {
    constructor(text, component = null) {
      super(text);
      this.component = component;
    }
  }

  class Simulator {
    static async open(bundle) {
      const it = new Simulator();
      it.bundle = bundle;
      it.keys = bundle.keys;
      it.fixed = bundle.fixed;
      it.machine = await Machine.open(bundle.engine, bundle.modules);
      it.image = await block(bundle.image);
      it.inside = await numbers(bundle.inside, Uint32Array);
      it.base = it.machine.reserve(it.image.length + 8);
      it.logs = bundle.components.map(() => it.machine.reserve(bundle.log.size));
      it.names = bundle.components.map((c) => it.machine.text(c.name));
      it.frozen = [];
      for (const {link, rows} of bundle.frozen) {
        it.frozen.push({link, ...await it.values(rows, Int32Array)});
      }
      it.played = [];
      for (const values of bundle.played) it.played.push(await it.values(values, Float64Array));
      it.drawn = bundle.drawn.map((drawn) => (
        {...drawn, at: it.machine.reserve(4 * drawn.rows), count: drawn.rows}));
      it.handles = [];
      it.callbacks = [];
      return it;
    }

    async values(text, Kind) {
      const found = await numbers(text, Kind), at = this.machine.reserve(found.byteLength);
      this.machine.bytes.set(new Uint8Array(found.buffer), at);
      return {at, count: found.length};
    }

    /** The run with other values of keys; `progress` is called with (ticks done, all ticks). */
    async compute(values = {}, progress = () => {}) {
      const before = now(), result = this.run(values, progress);
      result.digest = await digest(result);
      result.seconds = (now() - before) / 1000;
      return result;
    }

    run(values, progress) {
      const {bundle} = this, record = new Record(bundle);
      let failure = null, ended = null;
      try {
        this.load(this.checked(values));
        this.start();
        ended = this.loop(record, progress);
      } catch (error) {
        if (!(error instanceof Failure) && !(error instanceof WebAssembly.RuntimeError)) throw error;
        const time = bundle.start + this.tick() * bundle.h;
        failure = {text: error.message, component: error.component ?? null, time};
      }
      return {...record.result(), ended, failure};
    }

    /** The values of all keys. Throws RangeError for what a page cannot compute. */
    checked(values) {
      const all = {};
      for (const {key, value, low, high, choices} of this.keys) {
        let x = values[key] ?? value;
        if (choices.length) x = choices.find((choice) => Math.abs(choice - x) <= 1e-9 * choice) ?? NaN;
        if (!(x >= low && x <= high)) {
          const expected = choices.length ? `one of ${choices.join(", ")}` : `${low} to ${high}`;
          throw new RangeError(`${key} = ${values[key]}; expected ${expected}`);
        }
        all[key] = x;
      }
      for (const key of Object.keys(values)) {
        if (!(key in all)) throw new RangeError(`${key} cannot be moved in this page`);
      }
      for (const {low, high} of this.bundle.ordered) {
        if (all[low] > all[high]) {
          throw new RangeError(`${low} = ${all[low]} is more than ${high} = ${all[high]}`);
        }
      }
      return all;
    }

    /* -- memory -- */

    /** The image, with addresses and the values of keys. */
    load(values) {
      const {bundle, machine, base, inside} = this;
      this.free();
      machine.bytes.set(this.image, base);
      const view = machine.view, put = (at, value) => view.setUint32(base + at, value, true);
      for (let i = 0; i < inside.length; i += 2) put(inside[i], base + inside[i + 1]);
      for (const {module, name, places} of bundle.functions) {
        const call = machine.modules[module][name];
        if (!call) throw new Error(`${module} has no ${name}`);
        const index = machine.index(call);
        for (const at of places) put(at, index);
      }
      for (const [at, i] of bundle.logs) put(at, this.logs[i]);
      for (const write of bundle.writes) this.write(write, values);
      this.instantiate();
      for (const [at, i] of bundle.instances) machine.view.setUint32(base + at, this.handles[i], true);
      for (const [at, i] of bundle.values) {
        const {module, fmi} = bundle.components[i];
        const place = machine.modules[module][`fmi${fmi}_values`](this.handles[i]);
        machine.view.setUint32(base + at, place, true);
      }
    }

    /** The numbers that follow from keys: see cosim.live.keys. */
    write({rule, of, at, choices}, values) {
      const {view} = this.machine, [x, y] = of.map((key) => typeof key === "number" ? key : values[key]);
      if (rule === "ratio") {
        const [, draws, samples] = choices.find(([choice]) => choice === x);
        [draws, samples, samples].forEach((whole, i) => (
          view.setBigInt64(this.base + at[i], BigInt(whole), true)));
        return;
      }
      for (const place of at) view.setFloat64(this.base + place, rule === "value" ? x : x - y, true);
    }

    free() {
      this.handles.forEach((handle, i) => {
        const {module, fmi} = this.bundle.components[i];
        if (handle) this.machine.modules[module][`fmi${fmi}FreeInstance`](handle);
      });
      this.handles = [];
    }

    instantiate() {
      const {machine, bundle} = this, {core} = machine;
      bundle.components.forEach((component, i) => {
        const {module, fmi, name, token} = component, calls = machine.modules[module];
        const log = this.logs[i];
        this.texts ??= new Map();
        if (!this.texts.has(token)) this.texts.set(token, machine.text(token));
        const text = this.texts.get(token), none = (this.none ??= machine.text(""));
        machine.bytes.fill(0, log, log + bundle.log.size);
        core.engine_log_open(this.names[i], log);
        let handle;
        if (fmi === 2) {
          const callbacks = (this.callbacks[i] ??= machine.reserve(20));
          const calls2 = [core.engine_log2, core.calloc, core.free].map((f) => machine.index(f));
          [...calls2, 0, log].forEach((value, n) => (
            machine.view.setUint32(callbacks + 4 * n, value, true)));
          handle = calls.fmi2Instantiate(this.names[i], 1, text, none, callbacks, 0, 0);
        } else {
          const logger = machine.index(core.engine_log3);
          handle = calls.fmi3InstantiateCoSimulation(
            this.names[i], text, none, 0, 0, 0, 0, 0, 0, log, logger, 0);
        }
        if (!handle) throw new Failure(`${name} does not start: ${this.said(i)}`, name);
        this.handles.push(handle);
      });
    }

    /** The last lines that a component logged. */
    said(i) {
      const {view} = this.machine, {line, width, lines} = this.bundle.log, log = this.logs[i];
      const count = Number(view.getBigInt64(log, true));
      if (!count) return "the FMU logged nothing; log = true in its component, or --fmu-log, may tell more";
      const found = [];
      for (let k = Math.max(0, count - 3); k < count; k++) {
        found.push(this.machine.read(log + line + width * (k % lines)).split(/\s+/).filter(Boolean).join(" "));
      }
      return found.join("; ");
    }

    /** Where a member of a struct is. */
    at(struct, member) {
      return this.base + this.bundle.places[struct] + this.bundle.layouts[struct].members[member];
    }

    whole(struct, member) {
      return Number(this.machine.view.getBigInt64(this.at(struct, member), true));
    }

    setWhole(struct, member, value) {
      this.machine.view.setBigInt64(this.at(struct, member), BigInt(value), true);
    }

    small(struct, member) {
      return this.machine.view.getInt32(this.at(struct, member), true);
    }

    tick() {
      return this.whole("engine", "tick");
    }

    get signals() {
      const {bundle} = this;
      return this.machine.doubles(this.base + bundle.places.signals, bundle.n_signals);
    }

    /* -- start: as cosim.engine.initialization -- */

    start() {
      const {bundle, base} = this, {components} = bundle;
      this.stage(STAGE_ENTER, components.length, null);
      this.settle();
      for (let done = 0; done < components.length;) {
        this.setWhole("start", "n", components.length);
        this.setWhole("start", "at", done);
        this.setWhole("start", "call", 0);
        const result = this.machine.core.engine_start(base + bundle.places.start, STAGE_LEAVE);
        done = this.whole("start", "at");
        if (result === START_CHANGED) this.settle();
        else if (result !== START_DONE) this.refused(result, bundle.order[done]);
      }
      for (const [at, signal, count] of bundle.copies) {
        this.machine.doubles(base + at, count).set(this.signals.subarray(signal, signal + count));
      }
      const signals = this.signals;
      for (const {name, outputs} of components) {
        for (const {signal, at, size} of outputs) {
          const values = [...signals.subarray(at, at + size)];
          if (values.every(Number.isFinite)) continue;
          throw new Failure(`${signal} = [${values.map(repr).join(", ")}] at the start`, name);
        }
      }
    }

    stage(stage, n) {
      this.setWhole("start", "n", n);
      this.setWhole("start", "at", 0);
      this.setWhole("start", "call", 0);
      const result = this.machine.core.engine_start(this.base + this.bundle.places.start, stage);
      if (result !== START_DONE) this.refused(result, this.whole("start", "at"));
    }

    settle() {
      this.setWhole("start", "n", this.bundle.components.length);
      this.setWhole("start", "at", -1);
      this.setWhole("start", "call", 0);
      this.setWhole("start", "passes", 0);
      const result = this.machine.core.engine_settle(this.base + this.bundle.places.start);
      if (result !== START_DONE) this.refused(result, this.whole("start", "at"));
    }

    refused(result, i) {
      const name = this.bundle.components[i]?.name ?? "";
      if (result === START_REFUSED) {
        const status = STATUS[this.small("start", "status")] ?? "an unknown status";
        throw new Failure(`${name} does not start: a call returned ${status}: ${this.said(i)}`, name);
      }
      if (result === START_OTHER) throw new Failure(`${name} does not start: an input is not finite`, name);
      throw new Failure(`${name} does not start (${result})`, name);
    }

    /* -- ticks: as cosim.engine.engine -- */

    tables() {
      const {bundle, machine, base} = this, {layouts, places} = bundle, {view} = machine;
      const link = (i, member) => base + places.links + i * layouts.links.size + layouts.links.members[member];
      const give = (i, {at, count}) => {
        view.setUint32(link(i, "table"), at, true);
        view.setBigInt64(link(i, "row"), 0n, true);
        view.setBigInt64(link(i, "rows"), BigInt(count), true);
      };
      for (const one of [...this.frozen, ...this.drawn]) give(one.link, one);
      if (this.drawn.length) {
        const {size, members} = layouts.tables, first = base + places.tables, n = BigInt(this.drawn.length);
        this.drawn.forEach(({at, count}, i) => {
          view.setUint32(first + i * size + members.rows, at, true);
          view.setBigInt64(first + i * size + members.n, BigInt(count), true);
        });
        machine.core.tables_seed(first, n, base + places.words, base + places.ends);
        const wrong = Number(machine.core.tables_rows(first, n));
        if (wrong >= 0) throw new Failure(`link ${this.drawn[wrong].name}: a delay that its law rules out`);
      }
      this.played.forEach(({at, count}, i) => {
        const {size, members} = layouts.players, player = base + places.players + i * size;
        view.setUint32(player + members.values, at, true);
        view.setBigInt64(player + members.row, 0n, true);
        view.setBigInt64(player + members.rows, BigInt(count), true);
      });
    }

    loop(record, progress) {
      const {bundle, machine, base} = this, {ticks, every, columns} = bundle, width = columns.length;
      const {engine} = bundle.places;
      this.tables();
      const chunk = Math.max(64, Math.min(CHUNK_TICKS, Math.floor(CHUNK_VALUES / Math.max(1, width))));
      this.buffer ??= machine.reserve(8 * width * chunk);
      this.setWhole("engine", "every", 1);
      for (;;) {
        const first = this.tick(), n = Math.min(chunk, ticks - first);
        machine.view.setUint32(this.at("engine", "record"), this.buffer, true);
        this.setWhole("engine", "row", 0);
        const result = machine.core.engine_run(base + engine, BigInt(n));
        const rows = this.whole("engine", "row");
        record.take(machine.doubles(this.buffer, width * rows), first, rows);
        const reached = this.tick(), ended = result === RUN_OK ? null : this.ended(result);
        const done = reached === ticks || ended !== null;
        if ((result !== RUN_OK && ended === null) || (done && rows === reached - first)) {
          record.last(this.signals, first + rows);
        }
        if (result !== RUN_OK && ended === null) throw this.failed(result);
        progress(reached, ticks);
        if (done) return ended;
      }
    }

    ended(result) {
      const i = this.small("engine", "failed_index"), {name, module, fmi} = this.bundle.components[i] ?? {};
      let at = null;
      if (result === RUN_TERMINATED || result === RUN_ENDED) {
        const {size, members} = this.bundle.layouts.units;
        at = this.machine.view.getFloat64(
          this.base + this.bundle.places.units + i * size + members.reached, true);
      } else if (result === RUN_STEP && fmi === 2 && this.small("engine", "failed_status") === 2) {
        const calls = this.machine.modules[module], found = (this.asked ??= this.machine.reserve(16));
        const yes = calls.fmi2GetBooleanStatus(this.handles[i], 3, found) < 2
          && this.machine.view.getInt32(found, true) !== 0;
        if (yes && calls.fmi2GetRealStatus(this.handles[i], 2, found + 8) < 2) {
          at = this.machine.view.getFloat64(found + 8, true);
        }
      }
      return at === null ? null : `ended by ${name} at t = ${short(at)} s`;
    }

    failed(result) {
      const {bundle} = this, tick = this.whole("engine", "failed_tick");
      const where = `at tick ${tick} (t = ${short(bundle.start + tick * bundle.h)} s)`;
      const i = this.small("engine", "failed_index"), status = this.small("engine", "failed_status");
      if (result === RUN_HISTORY) return new Failure(`link ${bundle.links[i]}: no such sample ${where}`);
      const component = bundle.components[i];
      let reason = `result ${result}`;
      if (result === RUN_NOT_FINITE) reason = `not a finite number: ${this.notFinite(component)}`;
      else if (result === RUN_EARLY_RETURN) {
        reason = "the FMU returned early from its step, which is not supported";
      } else if (result === RUN_STEP || result === RUN_SET || result === RUN_GET) {
        const verb = {[RUN_SET]: "setting inputs", [RUN_GET]: "getting outputs"}[result] ?? "doStep";
        reason = `${verb} returned ${STATUS[status] ?? `the unknown status ${status}`} (${this.said(i)})`;
      }
      return new Failure(`${component.name}: ${reason} ${where}`, component.name);
    }

    notFinite({outputs}) {
      const found = [], signals = this.signals;
      for (const {names, at} of outputs) {
        names.forEach((name, k) => {
          if (!Number.isFinite(signals[at + k])) found.push(`${name} = ${repr(signals[at + k])}`);
        });
      }
      return found.join(", ");
    }
  }

  /** The rows of a run: those of ticks k with k mod every = 0, and the last one. */
  class Record {
    constructor(bundle) {
      const rows = Math.floor(bundle.ticks / bundle.every) + 2;
      this.bundle = bundle;
      this.columns = bundle.columns.map(() => new Float64Array(rows));
      this.t = new Float64Array(rows);
      this.n = 0;
    }

    time(tick) {
      return this.bundle.start + tick * this.bundle.h;
    }

    take(values, first, rows) {
      const {every} = this.bundle, width = this.columns.length, {n} = this;
      const begin = (every - first % every) % every;
      let kept = n;
      for (let row = begin; row < rows; row += every) this.t[kept++] = this.time(first + row);
      for (let column = 0; column < width; column++) {
        const target = this.columns[column];
        for (let row = begin, at = n; row < rows; row += every) target[at++] = values[row * width + column];
      }
      this.n = kept;
      this.newest = first + rows - 1;
      if (rows) this.row = {tick: this.newest, values: values.slice((rows - 1) * width, rows * width)};
    }

    last(signals, tick) {
      this.t[this.n] = this.time(tick);
      this.bundle.columns.forEach((index, column) => { this.columns[column][this.n] = signals[index]; });
      this.n++;
    }

    result() {
      const cut = (column) => column.slice(0, this.n), signals = {};
      let at = 0;
      for (const {name, unit, names} of this.bundle.signals) {
        signals[name] = {unit, names, columns: this.columns.slice(at, at += names.length).map(cut)};
      }
      return {t: cut(this.t), signals};
    }
  }

  /** SHA-256 of a result, as cosim.live.digest computes it of a run. */
  async function digest({t, signals}) {
    if (typeof crypto === "undefined" || !crypto.subtle) return null;
    const named = [["t", t]];
    for (const {names, columns} of Object.values(signals)) {
      names.forEach((name, i) => named.push([name, columns[i]]));
    }
    const coder = new TextEncoder(), heads = named.map(([name]) => coder.encode(`${name}\0`));
    const size = named.reduce((sum, [, column], i) => sum + heads[i].length + column.byteLength, 0);
    const all = new Uint8Array(size);
    let at = 0;
    named.forEach(([, column], i) => {
      all.set(heads[i], at);
      at += heads[i].length;
      all.set(canonical(column), at);
      at += column.byteLength;
    });
    const found = new Uint8Array(await crypto.subtle.digest("SHA-256", all));
    return [...found].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  }

  /** The bytes of numbers, with one NaN: processors differ in the others. */
  function canonical(column) {
    let found = column;
    for (let i = 0; i < column.length; i++) {
      if (column[i] === column[i]) continue;
      if (found === column) found = column.slice();
      new BigUint64Array(found.buffer, found.byteOffset)[i] = 0x7ff8000000000000n;
    }
    return new Uint8Array(found.buffer, found.byteOffset, found.byteLength);
  }

  function now() {
    return typeof performance === "undefined" ? Date.now() : performance.now();
  }

  return {open: (bundle) => Simulator.open(bundle)};
})();
if (typeof module !== "undefined") module.exports = Live;
