// Draws the charts of the page from the data in it. It knows lines, bands and points, not what they mean.
"use strict";
(() => {
  const page = JSON.parse(document.getElementById("data").textContent);
  // The name space of SVG, as the browser itself knows it.
  const SVG = document.getElementById("pattern").namespaceURI;
  const MARGIN = { left: 66, right: 12, top: 8, bottom: 38 };
  const shown = new Map(page.series.map((one) => [one.name, one.shown]));
  const looks = new Map(page.series.map((one) => [one.name, one]));
  const charts = [];

  const column = (chart, values) => (typeof values === "string" ? page.columns[values] : values);
  const visible = (item) => item.series === undefined || shown.get(item.series);
  const colour = (item) => item.colour || looks.get(item.series).colour;
  const dash = (item) => item.dash || (item.series && looks.get(item.series).dash) || "";

  function make(name, attributes, parent) {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (parent) parent.appendChild(element);
    return element;
  }

  function text(content, attributes, parent) {
    make("text", attributes, parent).textContent = content;
  }

  // --- ranges --------------------------------------------------------------------------------------

  function extremes(lists, trim) {
    let values = [];
    for (const list of lists) for (const value of list) if (value !== null) values.push(value);
    if (!values.length) return null;
    if (trim) {
      values.sort((a, b) => a - b);
      const cut = Math.floor(values.length * trim);
      values = values.slice(cut, values.length - cut);
    }
    let low = Infinity, high = -Infinity;
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    return [low, high];
  }

  function padded([low, high], share, least) {
    const margin = Math.max((high - low) * share, least);
    return [low - margin, high + margin];
  }

  function home(chart) {
    const spec = chart.spec;
    const items = [...(spec.lines || []), ...(spec.points || [])].filter(visible);
    const all = [...(spec.lines || []), ...(spec.points || [])];
    const used = items.length ? items : all;
    const x = spec.x_range || extremes(used.map((item) => column(chart, item.x))) || [0, 1];
    let y = extremes(used.map((item) => column(chart, item.y)), spec.trim) || [0, 1];
    const bands = (spec.bands || []).filter(visible);
    if (bands.length) {
      // Bounds may run away in a hole of the log; the picture is of the lines.
      const size = Math.max(Math.abs(y[0]), Math.abs(y[1]), y[1] - y[0], spec.least,
        spec.band_size || 0);
      const edges = extremes(bands.flatMap((item) => [item.low, item.high]));
      if (edges) {
        y = [Math.min(y[0], Math.max(edges[0], y[0] - size)),
          Math.max(y[1], Math.min(edges[1], y[1] + size))];
      }
    }
    for (const level of spec.levels || []) y = [Math.min(y[0], level.y), Math.max(y[1], level.y)];
    if (spec.limit) y = [Math.max(y[0], -spec.limit), Math.min(y[1], spec.limit)];
    y = padded(y, 0.06, spec.least);
    if (spec.floor !== undefined && y[0] < spec.floor) y[0] = spec.floor;
    if (!spec.map) return { x: x[1] > x[0] ? x : padded(x, 0, 0.5), y };
    return fitted(chart, padded(x, 0.05, spec.least), y);
  }

  // Both axes of a map have the same scale.
  function fitted(chart, x, y) {
    const { width, height } = inner(chart);
    const scale = Math.max((x[1] - x[0]) / width, (y[1] - y[0]) / height);
    const [cx, cy] = [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2];
    return {
      x: [cx - scale * width / 2, cx + scale * width / 2],
      y: [cy - scale * height / 2, cy + scale * height / 2],
    };
  }

  function inner(chart) {
    return {
      width: chart.width - MARGIN.left - MARGIN.right,
      height: chart.height - MARGIN.top - MARGIN.bottom,
    };
  }

  // --- drawing -------------------------------------------------------------------------------------

  function ticks([low, high], wanted) {
    const rough = (high - low) / Math.max(wanted, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough * 0.999);
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) {
      found.push(k * step);
    }
    const digits = Math.min(20, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
    const far = Math.max(Math.abs(low), Math.abs(high));
    const told = (value) => (far < 1e-3 || far >= 1e6)
      ? (value === 0 ? "0" : value.toExponential(1).replace("e-", "e−").replace("e+", "e"))
      : value.toFixed(digits);
    return found.map((value) => [value, told(Math.abs(value) < step * 1e-9 ? 0 : value)
      .replace(/^-/, "−")]);
  }

  function draw(chart) {
    const { svg, spec, view } = chart;
    const { width, height } = inner(chart);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${chart.width} ${chart.height}`);
    svg.setAttribute("height", chart.height);
    const kx = width / (view.x[1] - view.x[0]), ky = height / (view.y[1] - view.y[0]);
    const px = (x) => MARGIN.left + (x - view.x[0]) * kx;
    const py = (y) => MARGIN.top + height - (y - view.y[0]) * ky;
    const clip = `clip-${chart.number}`;
    const hole = make("clipPath", { id: clip }, make("defs", {}, svg));
    make("rect", { x: MARGIN.left, y: MARGIN.top, width, height }, hole);
    for (const [value, told] of ticks(view.x, width / 75)) {
      make("line", { class: "grid", x1: px(value), x2: px(value), y1: MARGIN.top,
        y2: MARGIN.top + height }, svg);
      text(told, { x: px(value), y: MARGIN.top + height + 16, "text-anchor": "middle" }, svg);
    }
    for (const [value, told] of ticks(view.y, height / 32)) {
      make("line", { class: "grid", y1: py(value), y2: py(value), x1: MARGIN.left,
        x2: MARGIN.left + width }, svg);
      text(told, { x: MARGIN.left - 5, y: py(value) + 4, "text-anchor": "end" }, svg);
    }
    text(spec.x_label, { x: MARGIN.left + width / 2, y: chart.height - 4,
      "text-anchor": "middle" }, svg);
    const middle = MARGIN.top + height / 2;
    text(spec.y_label, { x: 12, y: middle, "text-anchor": "middle",
      transform: `rotate(-90 12 ${middle})` }, svg);
    const inside = make("g", { "clip-path": `url(#${clip})` }, svg);
    for (const span of spec.spans || []) {
      make("rect", { x: px(span[0]), width: Math.max(0, (span[1] - span[0]) * kx), y: MARGIN.top,
        height, fill: "#000", "fill-opacity": 0.05 }, inside);
    }
    for (const band of (spec.bands || []).filter(visible)) {
      for (const shape of bandShapes(column(chart, band.x), band.low, band.high, px, py)) {
        make("path", { d: shape, fill: colour(band), "fill-opacity": 0.11,
          stroke: colour(band), "stroke-opacity": 0.4, "stroke-width": 0.7 }, inside);
      }
    }
    for (const level of spec.levels || []) {
      make("line", { x1: MARGIN.left, x2: MARGIN.left + width, y1: py(level.y), y2: py(level.y),
        stroke: "#555", "stroke-dasharray": level.dash || "", "stroke-width": 1 }, inside);
    }
    for (const line of (spec.lines || []).filter(visible)) {
      const d = linePath(column(chart, line.x), column(chart, line.y), px, py);
      make("path", { d, fill: "none", stroke: colour(line), "stroke-width": line.width || 1.5,
        "stroke-dasharray": dash(line), "stroke-linejoin": "round" }, inside);
    }
    for (const dots of (spec.points || []).filter(visible)) drawDots(chart, dots, px, py, inside);
    make("rect", { class: "frame", x: MARGIN.left, y: MARGIN.top, width, height }, svg);
  }

  function linePath(xs, ys, px, py) {
    let d = "", pen = false;
    for (let i = 0; i < xs.length; i++) {
      if (ys[i] === null || xs[i] === null) { pen = false; continue; }
      d += `${pen ? "L" : "M"}${px(xs[i]).toFixed(1)} ${py(ys[i]).toFixed(1)}`;
      pen = true;
    }
    return d;
  }

  function bandShapes(xs, lows, highs, px, py) {
    const shapes = [];
    let there = [], back = [];
    const close = () => {
      if (there.length > 1) shapes.push(`M${there.join("L")}L${back.reverse().join("L")}Z`);
      there = []; back = [];
    };
    for (let i = 0; i < xs.length; i++) {
      if (lows[i] === null || highs[i] === null) { close(); continue; }
      // Far outside of the picture, browsers lose precision.
      const [a, b] = [lows[i], highs[i]].map((y) => Math.min(Math.max(py(y), -1e4), 1e4));
      there.push(`${px(xs[i]).toFixed(1)} ${b.toFixed(1)}`);
      back.push(`${px(xs[i]).toFixed(1)} ${a.toFixed(1)}`);
    }
    close();
    return shapes;
  }

  function drawDots(chart, dots, px, py, parent) {
    const xs = column(chart, dots.x), ys = column(chart, dots.y), size = dots.size || 1.6;
    let d = "";
    for (let i = 0; i < xs.length; i++) {
      if (ys[i] === null || xs[i] === null) continue;
      const [x, y] = [px(xs[i]), py(ys[i])];
      if (dots.shape === "cross") {
        d += `M${(x - size).toFixed(1)} ${y.toFixed(1)}h${2 * size}m${-size} ${-size}v${2 * size}`;
      } else if (dots.shape === "square") {
        d += `M${(x - size).toFixed(1)} ${(y - size).toFixed(1)}h${2 * size}v${2 * size}h${-2 * size}z`;
      } else {
        d += `M${x.toFixed(1)} ${y.toFixed(1)}h0`;
      }
    }
    const stroke = { d, stroke: colour(dots), fill: dots.shape === "square" ? colour(dots) : "none" };
    if (!dots.shape) Object.assign(stroke, { "stroke-width": 2 * size, "stroke-linecap": "round" });
    make("path", stroke, parent);
  }

  // --- zooming -------------------------------------------------------------------------------------

  function zoom(chart, factor, at) {
    const { view, spec } = chart;
    const { width, height } = inner(chart);
    const sx = Math.min(1, Math.max(0, (at[0] - MARGIN.left) / width));
    const sy = Math.min(1, Math.max(0, 1 - (at[1] - MARGIN.top) / height));
    const about = (range, share) => {
      const [fixed, size] = [range[0] + share * (range[1] - range[0]), range[1] - range[0]];
      const least = 1e-6 * Math.max(1, Math.abs(fixed));
      const wanted = Math.min(Math.max(size / factor, least), 1e9);
      return [fixed - share * wanted, fixed + (1 - share) * wanted];
    };
    view.x = about(view.x, sx);
    if (spec.map) view.y = about(view.y, sy);
    moved(chart);
  }

  function pan(chart, dx, dy) {
    const { view, spec } = chart;
    const { width, height } = inner(chart);
    const shift = (range, share) => range.map((edge) => edge + share * (range[1] - range[0]));
    view.x = shift(view.x, -dx / width);
    if (spec.map) view.y = shift(view.y, dy / height);
    moved(chart);
  }

  function moved(chart) {
    chart.touched = true;
    if (!chart.waiting) {
      chart.waiting = true;
      requestAnimationFrame(() => { chart.waiting = false; draw(chart); });
    }
  }

  function reset(chart) {
    chart.touched = false;
    chart.view = home(chart);
    draw(chart);
  }

  function place(chart, event) {
    const box = chart.svg.getBoundingClientRect();
    const scale = chart.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  function listen(chart) {
    const { svg, spec } = chart;
    const fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return [Math.hypot(a[0] - b[0], a[1] - b[1]), [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]];
    };
    svg.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, place(chart, event));
      try { svg.setPointerCapture(event.pointerId); } catch { /* it is gone already */ }
    });
    svg.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = place(chart, event);
      if (fingers.size === 1) {
        fingers.set(event.pointerId, now);
        if (spec.map || chart.touched) pan(chart, now[0] - before[0], now[1] - before[1]);
        return;
      }
      if (fingers.size > 2) return;
      const [apart, middle] = spread();
      fingers.set(event.pointerId, now);
      const [wider, there] = spread();
      pan(chart, there[0] - middle[0], there[1] - middle[1]);
      if (apart > 0 && wider > 0) zoom(chart, wider / apart, there);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      svg.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    svg.addEventListener("wheel", (event) => {
      // Over charts in time the wheel scrolls the page, unless Ctrl is held, which is also a pinch.
      if (!spec.map && !event.ctrlKey) return;
      event.preventDefault();
      zoom(chart, Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), place(chart, event));
    }, { passive: false });
    svg.addEventListener("dblclick", () => reset(chart));
  }

  // --- the page ------------------------------------------------------------------------------------

  function measure(chart) {
    chart.width = Math.max(240, chart.figure.clientWidth);
    chart.height = chart.spec.map ? Math.round(Math.min(0.8 * chart.width, 600))
      : Math.round(Math.min(Math.max(0.5 * chart.width, 200), 320));
  }

  function button(name, label, act, parent) {
    const element = document.createElement("button");
    element.type = "button";
    element.textContent = name;
    element.setAttribute("aria-label", label);
    element.addEventListener("click", act);
    parent.appendChild(element);
  }

  function build(spec, number) {
    const figure = document.createElement("figure");
    const title = document.createElement("h3");
    title.textContent = spec.title;
    const svg = make("svg", { class: spec.map ? "map" : "over", role: "img" });
    svg.setAttribute("aria-label", `${spec.title}: ${spec.y_label} over ${spec.x_label}`);
    figure.append(title, svg);
    const chart = { spec, number, figure, svg, touched: false };
    if (spec.map) {
      const bar = document.createElement("div");
      bar.className = "buttons";
      const centre = () => [chart.width / 2, chart.height / 2];
      button("+", "zoom in", () => zoom(chart, 1.5, centre()), bar);
      button("−", "zoom out", () => zoom(chart, 1 / 1.5, centre()), bar);
      button("Reset", "show all", () => reset(chart), bar);
      figure.append(bar);
    }
    if (spec.note) {
      const caption = document.createElement("figcaption");
      caption.textContent = spec.note;
      figure.append(caption);
    }
    document.getElementById(spec.place).append(figure);
    charts.push(chart);
    listen(chart);
  }

  function redraw(keep) {
    for (const chart of charts) {
      if (keep && chart.touched) draw(chart);
      else reset(chart);
    }
  }

  page.charts.forEach(build);
  charts.forEach(measure);
  redraw(false);
  for (const box of document.querySelectorAll(".toggles input")) {
    // A browser may remember from an earlier visit what was ticked.
    box.checked = shown.get(box.value);
    box.addEventListener("change", () => { shown.set(box.value, box.checked); redraw(true); });
  }
  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    charts.forEach(measure);
    redraw(false);
  });
  document.body.dataset.drawn = String(charts.length);
})();
