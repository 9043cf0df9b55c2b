// Charts over time or distance: lines, bands, points. Their range and their cursor are common to all.
"use strict";
const Charts = (() => {
  const MARGIN = { left: 78, right: 12, top: 8, bottom: 38 };
  // Thickness of the stripe at the edge of a chart that stands for a band beyond it [px].
  const STRIPE = 3;
  // Size of a band, in sizes of the chart, from which it would only fill it.
  const FAR_BEYOND = 3;
  // Least drag that is a range and no click [px].
  const LEAST_DRAG = 6;
  const { make, html } = Svg;
  const charts = [];
  const values = html("div", document.body, undefined, { class: "values", hidden: "" });

  // --- data ----------------------------------------------------------------------------------------

  const scaled = new Map();
  function column(name, scale = 1) {
    const key = `${scale} ${name}`;
    if (scale === 1) return State.columns[name];
    if (!scaled.has(key)) {
      scaled.set(key, State.columns[name].map((one) => (one === null ? null : one * scale)));
    }
    return scaled.get(key);
  }

  const breaks = new Map(Object.entries(State.page.breaks).map(([key, rows]) => [key, new Set(rows)]));
  const breaksOf = (name) => breaks.get(name) || new Set();

  // Lower and upper edge of a band at a row, or null.
  function edges(spec, band, row) {
    const half = column(band.sigma)[row], middle = band.middle ? column(band.middle)[row] : 0;
    if (half === null || middle === null) return null;
    const low = (middle - band.times * half) * band.scale;
    const high = (middle + band.times * half) * band.scale;
    return spec.floor === undefined ? [low, high] : [Math.max(low, spec.floor), high];
  }

  function inView(item) {
    const xs = State.along(item.x), ys = column(item.y, item.scale);
    if (!State.range) return ys;
    const [low, high] = State.range;
    return ys.filter((_, row) => xs[row] >= low && xs[row] <= high);
  }

  function whole() {
    const x = Svg.extremes(State.along("t")) || [0, 1];
    return x[1] > x[0] ? x : Svg.padded(x, 0, 0.5);
  }

  function home(chart) {
    const { spec } = chart;
    const all = [...(spec.lines || []), ...(spec.points || [])];
    const seen = all.filter(State.visible);
    const found = (seen.length ? seen : all).flatMap(inView);
    let y = Svg.extremes(found, spec.trim) || Svg.extremes(all.flatMap(inView), spec.trim) || [0, 1];
    for (const level of spec.levels || []) y = [Math.min(y[0], level.y), Math.max(y[1], level.y)];
    if (spec.limit) y = [Math.max(y[0], -spec.limit), Math.min(y[1], spec.limit)];
    y = grown(spec, y);
    y = Svg.padded(y, 0.06, spec.least);
    if (spec.floor !== undefined && y[0] < spec.floor) y[0] = spec.floor;
    return { x: State.range || whole(), y };
  }

  // Range with the usual part of the bands; where they run away, the picture stays one of the lines.
  function grown(spec, y) {
    const bands = State.bands ? (spec.bands || []).filter(State.visible) : [];
    if (!bands.length) return y;
    const lows = [], highs = [];
    for (const band of bands) {
      const xs = State.along(band.x);
      for (let row = 0; row < xs.length; row++) {
        if (State.range && (xs[row] < State.range[0] || xs[row] > State.range[1])) continue;
        const found = edges(spec, band, row);
        if (found) { lows.push(found[0]); highs.push(found[1]); }
      }
    }
    if (!lows.length) return y;
    const usual = (list, share) => list.sort((a, b) => a - b)[Math.floor(share * (list.length - 1))];
    const size = Math.max(Math.abs(y[0]), Math.abs(y[1]), y[1] - y[0], spec.least);
    return [Math.min(y[0], Math.max(usual(lows, 0.1), y[0] - size)),
      Math.max(y[1], Math.min(usual(highs, 0.9), y[1] + size))];
  }

  // --- drawing -------------------------------------------------------------------------------------

  const inner = (chart) => Svg.inner(chart, MARGIN);

  function draw(chart) {
    const { svg, spec } = chart;
    // A chart of hidden variants alone is hidden with them.
    chart.figure.hidden = ![...(spec.lines || []), ...(spec.points || [])].some(State.visible);
    const view = chart.view = home(chart);
    const { width, height } = inner(chart);
    const kx = width / (view.x[1] - view.x[0]), ky = height / (view.y[1] - view.y[0]);
    const px = (x) => MARGIN.left + (x - view.x[0]) * kx;
    const py = (y) => MARGIN.top + height - (y - view.y[0]) * ky;
    Object.assign(chart, { px, py });
    const labels = { x: State.axis(), y: spec.y_label }, clip = `clip-${chart.number}`;
    const clipped = Svg.axes(chart, MARGIN, { px, py, labels, spacing: 38, clip });
    const inside = clipped();
    for (const [spans, kind] of [[spec.spans || [], "span"], [State.page.holes, "hole"]]) {
      for (const [begin, end] of spans.map((one) => one.map(State.place))) {
        make("rect", { class: kind, x: px(begin), width: Math.max(2, (end - begin) * kx), y: MARGIN.top, height },
          inside);
      }
    }
    const bands = State.bands ? (spec.bands || []).filter(State.visible) : [];
    bands.forEach((band, number) => drawBand(chart, band, number, inside));
    for (const level of spec.levels || []) {
      make("line", { class: "level", x1: MARGIN.left, x2: MARGIN.left + width, y1: py(level.y),
        y2: py(level.y), "stroke-dasharray": level.dash || "" }, inside);
    }
    for (const line of (spec.lines || []).filter(State.visible)) {
      const d = Svg.linePath(State.along(line.x), column(line.y, line.scale), px, py, breaksOf(line.x));
      make("path", { d, fill: "none", stroke: State.colour(line), "stroke-width": line.width || 1.5,
        "stroke-dasharray": State.dash(line), "stroke-linejoin": "round" }, inside);
    }
    for (const dots of (spec.points || []).filter(State.visible)) drawDots(chart, dots, inside);
    make("rect", { class: "frame", x: MARGIN.left, y: MARGIN.top, width, height }, svg);
    chart.marks = clipped();
    mark(chart);
  }

  // A band that is far wider than the chart would hide all else: a stripe at its edge stands for it.
  function drawBand(chart, band, number, parent) {
    const { spec, view, px, py } = chart, xs = State.along(band.x), colour = State.colour(band);
    const lifted = breaksOf(band.x);
    let there = [], back = [], beyond = [];
    const close = () => {
      if (there.length > 1) {
        make("path", { d: `M${there.join("L")}L${[...back].reverse().join("L")}Z`, fill: colour,
          "fill-opacity": 0.07 }, parent);
        make("path", { d: `M${there.join("L")}M${back.join("L")}`, fill: "none", stroke: colour,
          "stroke-opacity": 0.5, "stroke-width": 0.8 }, parent);
      }
      if (beyond.length > 1) {
        const at = MARGIN.top + STRIPE * (number + 0.5);
        make("path", { d: `M${beyond[0]} ${at}H${beyond[beyond.length - 1]}`, stroke: colour,
          "stroke-width": STRIPE, "stroke-opacity": 0.7 }, parent);
      }
      there = []; back = []; beyond = [];
    };
    for (let row = 0; row < xs.length; row++) {
      const found = xs[row] === null ? null : edges(spec, band, row);
      if (!found || lifted.has(row)) close();
      if (!found) continue;
      const x = px(xs[row]).toFixed(1);
      const bottom = spec.floor === undefined ? view.y[0] : spec.floor;
      const far = view.y[0] + FAR_BEYOND * (view.y[1] - view.y[0]);
      if (found[1] > far && found[0] <= bottom) {
        if (there.length) close();
        beyond.push(x);
        continue;
      }
      if (beyond.length) close();
      // Far outside of the picture, browsers lose precision.
      const [a, b] = found.map((y) => Math.min(Math.max(py(y), -1e4), 1e4).toFixed(1));
      there.push(`${x} ${b}`);
      back.push(`${x} ${a}`);
    }
    close();
  }

  function drawDots(chart, dots, parent) {
    const xs = State.along(dots.x), ys = column(dots.y, dots.scale), size = dots.size || 1.6;
    let d = "";
    for (let i = 0; i < xs.length; i++) {
      if (ys[i] === null || xs[i] === null) continue;
      d += `M${chart.px(xs[i]).toFixed(1)} ${chart.py(ys[i]).toFixed(1)}h0`;
    }
    make("path", { d, fill: "none", stroke: State.colour(dots), "stroke-width": 2 * size,
      "stroke-linecap": "round" }, parent);
  }

  // --- the cursor ----------------------------------------------------------------------------------

  // Row of an item nearest to the cursor, or -1 in a hole of the log.
  function rowAt(item) {
    if (State.inHole(State.cursor)) return -1;
    const times = State.columns[item.x], before = State.row(times, State.cursor);
    if (before < 0) return times.length ? 0 : -1;
    const after = Math.min(before + 1, times.length - 1);
    return times[after] - State.cursor < State.cursor - times[before] ? after : before;
  }

  function mark(chart) {
    const { spec, marks, px, py } = chart;
    marks.replaceChildren();
    if (State.cursor === null) return;
    const { height } = inner(chart), x = px(State.place(State.cursor));
    make("line", { class: "cursor", x1: x, x2: x, y1: MARGIN.top, y2: MARGIN.top + height }, marks);
    for (const line of (spec.lines || []).filter(State.visible)) {
      const row = rowAt(line), y = row < 0 ? null : column(line.y, line.scale)[row];
      if (y === null || y === undefined) continue;
      make("circle", { cx: px(State.along(line.x)[row]), cy: py(y), r: 2.8,
        fill: State.colour(line) }, marks);
    }
  }

  // Values of all visible series at the cursor, beside the pointer.
  function tell(chart, event) {
    values.replaceChildren();
    const travelled = State.at("distance", State.cursor);
    html("b", values, `${State.cursor.toFixed(1)} s, ${Svg.number(travelled)} m driven`);
    const isHole = State.inHole(State.cursor);
    if (isHole) html("div", values, "a hole of the log");
    const items = isHole ? [] : [...(chart.spec.lines || []), ...(chart.spec.points || [])].filter(State.visible);
    const [, unit = ""] = /\[([^\]-]+)\]/.exec(chart.spec.y_label) || [];
    for (const item of items) {
      const row = rowAt(item), value = row < 0 ? null : column(item.y, item.scale)[row];
      const band = (chart.spec.bands || []).find((one) => one.series === item.series);
      const line = html("div", values);
      Svg.swatch(line, State.look(item));
      let label = `${item.label || item.series}: ${Svg.number(value)} ${unit}`.trimEnd();
      const sigma = band && row >= 0 ? column(band.sigma)[row] : null;
      if (sigma !== null && sigma !== undefined) {
        label += ` (${band.times}σ ${Svg.number(band.times * band.scale * sigma)})`;
      }
      html("span", line, label);
    }
    values.hidden = false;
    const box = values.getBoundingClientRect();
    const left = event.clientX + 16 + box.width > window.innerWidth
      ? event.clientX - 16 - box.width : event.clientX + 16;
    const top = Math.min(event.clientY + 12, window.innerHeight - box.height - 8);
    values.style.left = `${Math.max(4, left)}px`;
    values.style.top = `${Math.max(4, top)}px`;
  }

  // --- pointer -------------------------------------------------------------------------------------

  function xAt(chart, event) {
    const box = chart.svg.getBoundingClientRect(), { width } = inner(chart);
    const share = ((event.clientX - box.left) * chart.width / box.width - MARGIN.left) / width;
    return chart.view.x[0] + Math.min(1, Math.max(0, share)) * (chart.view.x[1] - chart.view.x[0]);
  }

  // New range in view, within that of the log; all of it is no zoom.
  function limit(range) {
    const [low, high] = whole(), least = 1e-4 * (high - low);
    const found = [Math.max(low, Math.min(...range)), Math.min(high, Math.max(...range))];
    if (found[1] - found[0] < least) return;
    State.range = found[0] <= low && found[1] >= high ? null : found;
    State.change("range");
  }

  function zoom(factor, about) {
    limit((State.range || whole()).map((edge) => about + (edge - about) / factor));
  }

  function listen(chart) {
    const { svg } = chart, fingers = new Map();
    let from = null, spread = null;
    svg.addEventListener("pointerdown", (event) => {
      fingers.set(event.pointerId, event.clientX);
      if (event.pointerType !== "touch") from = event.clientX;
      try { svg.setPointerCapture(event.pointerId); } catch { /* it is gone already */ }
      spread = null;
    });
    svg.addEventListener("pointermove", (event) => {
      if (fingers.has(event.pointerId)) fingers.set(event.pointerId, event.clientX);
      if (fingers.size === 2) {
        const [a, b] = [...fingers.values()], now = Math.abs(a - b);
        if (spread && now > 0) zoom(now / spread, xAt(chart, { clientX: (a + b) / 2 }));
        spread = now;
        return;
      }
      if (!State.playing) {
        State.cursor = State.time(xAt(chart, event));
        State.change("cursor");
      }
      tell(chart, event);
      if (from !== null && Math.abs(event.clientX - from) > LEAST_DRAG) {
        const [a, b] = [xAt(chart, { clientX: from }), xAt(chart, event)].map(chart.px);
        make("rect", { class: "drag", x: Math.min(a, b), width: Math.abs(b - a), y: MARGIN.top,
          height: inner(chart).height }, chart.marks);
      }
    });
    const end = (event) => {
      fingers.delete(event.pointerId);
      if (from !== null && event.type === "pointerup" && Math.abs(event.clientX - from) > LEAST_DRAG) {
        limit([xAt(chart, { clientX: from }), xAt(chart, event)]);
      }
      from = null;
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      svg.addEventListener(name, end);
    }
    svg.addEventListener("pointerleave", () => { values.hidden = true; });
    svg.addEventListener("wheel", (event) => {
      // The wheel scrolls the page, unless Ctrl is held, which is also a pinch.
      if (!event.ctrlKey) return;
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * 0.01), xAt(chart, event));
    }, { passive: false });
    svg.addEventListener("dblclick", () => { State.range = null; State.change("range"); });
  }

  // --- the page ------------------------------------------------------------------------------------

  function measure(chart) {
    chart.width = Math.max(240, chart.figure.clientWidth);
    chart.height = Math.round(Math.min(Math.max(0.5 * chart.width, 220), 300));
  }

  // Charts out of sight need no cursor.
  const watch = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const chart = charts.find((one) => one.figure === entry.target);
      chart.seen = entry.isIntersecting;
      if (chart.seen && chart.marks) mark(chart);
    }
  });

  function build(spec) {
    const figure = html("figure");
    html("h3", figure, spec.title);
    const own = (spec.lines || []).filter((line) => line.label);
    if (own.length) {
      const key = html("p", figure, undefined, { class: "key" });
      for (const line of own) {
        const part = html("span", key);
        Svg.swatch(part, line);
        part.append(line.label);
      }
    }
    const svg = make("svg", { class: "over", role: "img", "aria-label": `${spec.title}: ${spec.y_label}` },
      figure);
    if (spec.note) html("figcaption", figure, spec.note);
    document.getElementById(spec.place).append(figure);
    const chart = { spec, number: charts.length, figure, svg, seen: true };
    charts.push(chart);
    listen(chart);
    watch.observe(figure);
  }

  function start() {
    State.page.charts.forEach(build);
    charts.forEach(measure);
    charts.forEach(draw);
    State.listen((what) => {
      if (what === "drive") return;
      if (what === "resize" || what === "fold") charts.forEach(measure);
      if (what === "cursor") charts.filter((one) => one.seen).forEach(mark);
      else charts.forEach(draw);
    });
    return charts.length;
  }

  return { start };
})();
