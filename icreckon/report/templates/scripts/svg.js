// Drawing with SVG: elements, ranges, ticks, numbers as text, colour scales.
"use strict";
const Svg = (() => {
  // The name space of SVG, as the browser itself knows it.
  const SPACE = document.getElementById("pattern").namespaceURI;
  const SCALES = {
    unsigned: ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725"],
    signed: ["#2166ac", "#67a9cf", "#d0d0d0", "#ef8a62", "#b2182b"],
  };

  function make(name, attributes, parent) {
    const element = document.createElementNS(SPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (parent) parent.appendChild(element);
    return element;
  }

  function text(content, attributes, parent) {
    const element = make("text", attributes, parent);
    element.textContent = content;
    return element;
  }

  function html(name, parent, content, attributes = {}) {
    const element = document.createElement(name);
    if (content !== undefined) element.textContent = content;
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (parent) parent.appendChild(element);
    return element;
  }

  // Piece of line in the colours of a series, before its name.
  function swatch(parent, look) {
    const element = html("span", parent, undefined, { class: "swatch" });
    element.style.setProperty("--light", look.colour);
    element.style.setProperty("--dark", look.dark);
  }

  function button(name, label, act, parent) {
    const element = html("button", parent, name, { type: "button", "aria-label": label });
    element.addEventListener("click", act);
    return element;
  }

  // --- ranges --------------------------------------------------------------------------------------

  // Least and largest of the numbers; `trim` is the share left out at both ends.
  function extremes(values, trim = 0) {
    let found = values.filter((value) => value !== null && Number.isFinite(value));
    if (!found.length) return null;
    if (trim) {
      found.sort((a, b) => a - b);
      const cut = Math.floor(found.length * trim);
      found = found.slice(cut, found.length - cut);
    }
    let low = Infinity, high = -Infinity;
    for (const value of found) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    return [low, high];
  }

  function padded([low, high], share, least) {
    const margin = Math.max((high - low) * share, least);
    return [low - margin, high + margin];
  }

  // Step of round numbers with about as many in a range as wanted.
  function stepOf(size, wanted) {
    const rough = size / Math.max(wanted, 1), power = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough * 0.999);
  }

  function ticks([low, high], wanted) {
    const step = stepOf(high - low, wanted), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) {
      found.push(k * step);
    }
    const digits = Math.min(20, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
    const far = Math.max(Math.abs(low), Math.abs(high));
    const label = (value) => (far < 1e-3 || step >= 1e5)
      ? (value === 0 ? "0" : value.toExponential(1).replace("e-", "e−").replace("e+", "e"))
      : value.toFixed(digits);
    return found.map((value) => [value, label(Math.abs(value) < step * 1e-9 ? 0 : value)
      .replace(/^-/, "−")]);
  }

  // Number with about three digits and a true minus sign.
  function number(value) {
    if (value === null || !Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && size < 1e-3) return value.toExponential(1).replace(/-/g, "−");
    const digits = size >= 100 ? 0 : size >= 10 ? 1 : size >= 0.1 || size === 0 ? 2 : 4;
    return value.toFixed(digits).replace("-", "−");
  }

  // --- axes ----------------------------------------------------------------------------------------

  // Size of the plot inside the margins of a drawing.
  function inner(drawing, margin) {
    return { width: drawing.width - margin.left - margin.right,
      height: drawing.height - margin.top - margin.bottom };
  }

  // Empty a drawing, and draw its grid with ticks and labels, about `spacing` apart along y [px].
  // Returns a function that adds a group which the plot clips.
  function axes(drawing, margin, { px, py, labels, spacing, clip }) {
    const { svg, view } = drawing, { width, height } = inner(drawing, margin);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${drawing.width} ${drawing.height}`);
    svg.setAttribute("height", drawing.height);
    const hole = make("clipPath", { id: clip }, make("defs", {}, svg));
    make("rect", { x: margin.left, y: margin.top, width, height }, hole);
    for (const [value, label] of ticks(view.x, width / 75)) {
      make("line", { class: "grid", x1: px(value), x2: px(value), y1: margin.top,
        y2: margin.top + height }, svg);
      text(label, { x: px(value), y: margin.top + height + 15, "text-anchor": "middle" }, svg);
    }
    for (const [value, label] of ticks(view.y, height / spacing)) {
      make("line", { class: "grid", x1: margin.left, x2: margin.left + width, y1: py(value),
        y2: py(value) }, svg);
      text(label, { x: margin.left - 5, y: py(value) + 4, "text-anchor": "end" }, svg);
    }
    text(labels.x, { x: margin.left + width / 2, y: drawing.height - 4, "text-anchor": "middle" }, svg);
    const middle = margin.top + height / 2;
    text(labels.y, { x: 12, y: middle, "text-anchor": "middle",
      transform: `rotate(-90 12 ${middle})` }, svg);
    return () => make("g", { "clip-path": `url(#${clip})` }, svg);
  }

  // --- shapes --------------------------------------------------------------------------------------

  // Path of a line that is lifted at unknown values and at the rows in `breaks`.
  function linePath(xs, ys, px, py, breaks) {
    let d = "", pen = false;
    for (let i = 0; i < xs.length; i++) {
      if (ys[i] === null || xs[i] === null) { pen = false; continue; }
      if (breaks.has(i)) pen = false;
      d += `${pen ? "L" : "M"}${px(xs[i]).toFixed(1)} ${py(ys[i]).toFixed(1)}`;
      pen = true;
    }
    return d;
  }

  // Colour at a share of a scale.
  function shade(scale, share) {
    const stops = SCALES[scale], at = Math.min(1, Math.max(0, share)) * (stops.length - 1);
    const low = Math.min(stops.length - 2, Math.floor(at)), part = at - low;
    const mixed = [1, 3, 5].map((k) => {
      const [a, b] = [stops[low], stops[low + 1]].map((one) => parseInt(one.slice(k, k + 2), 16));
      return Math.round(a + part * (b - a)).toString(16).padStart(2, "0");
    });
    return `#${mixed.join("")}`;
  }

  return { make, text, html, swatch, button, extremes, padded, stepOf, ticks, number, inner, axes, linePath,
    shade };
})();
