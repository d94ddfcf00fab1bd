/* What live pages share: the worker, the command that repeats a run, and sliders with fields. Needs common.js
   in front of it. */
"use strict";
page.live = (() => {
  const { find, make } = page;
  const able = typeof WebAssembly === "object" && typeof Worker === "function" && typeof DecompressionStream === "function";
  const tidy = (x) => Number(x.toPrecision(12));
  const quoted = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'"'"'`)}'`);
  /** The command that begins with `start`, with settings. */
  const command = (start, settings) => [start, ...settings.map((one) => `--set ${quoted(one)}`)].join(" ");

  let address = "";
  /** A worker of the scripts of the page with these names; `give_up` is told why it does not start. */
  function worker(names, take, give_up) {
    const scripts = () => names.map((name) => `${find(`live-${name}`).textContent}\n`);
    address ||= URL.createObjectURL(new Blob(scripts(), { type: "text/javascript" }));
    const made = new Worker(address);
    made.onmessage = ({ data }) => take(data);
    made.onerror = (event) => give_up(event.message || "its worker does not start");
    return made;
  }
  /** Do something while nothing else is to be done. */
  const idle = (call) => (window.requestIdleCallback ?? ((one) => setTimeout(one, 200)))(call);

  /** The slider and the field of a value. Of a value with choices, the slider has the number of one. `moved` is
      told a new value, `wrong` what cannot be one. */
  function slider(number, { key, label, about, unit, value, low, high, step, choices }, moved, wrong) {
    const id = `live-${number}`, title = `${about ? `${about} ` : ""}${key}`, shown = unit === "1" ? "" : unit;
    const nearest = (x) => choices.reduce((best, one) => (Math.abs(one - x) < Math.abs(best - x) ? one : best));
    const at = (x) => (choices.length ? choices.indexOf(nearest(x)) : x);
    const inside = (x) => (choices.length ? nearest(x) : Math.min(high, Math.max(low, x)));
    const least = tidy(value - Math.floor((value - low) / step + 1e-9) * step); // of a grid that has the value
    const ends = choices.length ? { min: 0, max: choices.length - 1, step: 1 } : { min: Math.min(least, value), max: high, step };
    const range = make("input", { type: "range", id, ...ends, value: at(value) });
    const field = make("input", { type: "number", min: low, max: high, step: "any", value, "aria-label": `${label}${shown ? `, ${shown}` : ""}`, title });
    const row = make("div", { class: "value" }, make("label", { for: id, title }, label), range, make("span", {}, field, ` ${shown}`));
    range.addEventListener("input", () => {
      const found = Number(range.value);
      moved(choices.length ? choices[found] : Math.abs(found - value) < step / 1e3 ? value : tidy(found));
    });
    field.addEventListener("change", () => {
      const bad = !field.checkValidity() || field.value === "";
      row.classList.toggle("wrong", bad);
      if (bad) wrong(`found ${field.value || "nothing"}, expected a number from ${low} to ${high}`);
      else moved(inside(Number(field.value)));
    });
    /** Show another value; what stands there already is not touched. */
    function show(x, other) {
      if (Number(range.value) !== at(x)) range.value = String(at(x));
      if (Number(field.value) !== x) field.value = String(x);
      range.setAttribute("aria-valuetext", `${x} ${unit}`);
      row.classList.toggle("moved", other);
    }
    return { row, inside, show };
  }
  return { able, command, idle, slider, worker };
})();
