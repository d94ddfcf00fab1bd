/* What the scripts of all pages share; buttons that copy a command. */
"use strict";
const page = (() => {
  const find = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const make = (tag, attributes = {}, ...children) => {
    const element = document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
  };
  const svg = (tag, attributes = {}) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    return element;
  };
  /** The bytes of a text in base64. */
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  /** Call what paints with colours of the style sheet when these change: in the dark, on paper. */
  const repaint = (paint) => {
    for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", paint);
  };
  /** A time with its unit, as at a tick of an axis. */
  const seconds = (t) => `${Number(t.toPrecision(9))} s`;
  const RAISED = { "-": "⁻", ..."⁰¹²³⁴⁵⁶⁷⁸⁹" };
  /** A number as people write it, with so many digits at the most; a dash where there is none. */
  const short = (v, digits = 5) => {
    if (v === null || v === undefined) return "–";
    if (v === 0 || (Math.abs(v) < 1e6 && Math.abs(v) >= 1e-3)) return Number(v.toPrecision(Math.max(digits, 6 * (Math.abs(v) >= 1e4)))).toString().replace("-", "−");
    const [mantissa, exponent] = v.toExponential(digits - 1).split("e");
    return `${Number(mantissa)} × 10${[...String(Number(exponent))].map((c) => RAISED[c]).join("")}`.replace("-", "−");
  };
  for (const button of document.querySelectorAll("button[data-copy]")) {
    button.hidden = false;
    button.addEventListener("click", async () => {
      const text = find(button.dataset.copy);
      try { await navigator.clipboard.writeText(text.textContent); button.textContent = "Copied"; }
      catch { getSelection().selectAllChildren(text); }
    });
  }
  return { find, css, make, svg, bytes, seconds, short, repaint };
})();
