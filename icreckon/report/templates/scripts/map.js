// The map: paths, what colours one of them, and the robot on it; moved and zoomed with the pointer.
"use strict";
const PathMap = (() => {
  const MARGIN = { left: 58, right: 10, top: 8, bottom: 38 };
  const TRUTH = "ground truth", FIXES = "fixes used";
  // Number of colours of a path.
  const SHADES = 24;
  // Least length of the robot, however far away it is seen from [px].
  const LEAST_ROBOT = 20;
  // Largest distance from the path to a pointer that picks a place on it [px].
  const REACH = 25;
  const { make, text, html } = Svg;
  const { drive, columns } = { drive: State.page.drive, columns: State.columns };
  const breaks = new Set(State.page.breaks.t);
  const map = { touched: false, active: false };
  // Choices of the drive, set by drive.js: the variant that drives, what colours its path.
  const choice = { driver: drive.first, colouring: null };

  const xs = (name) => columns[`${name}/x_m`], ys = (name) => columns[`${name}/y_m`];
  const names = () => Object.keys(drive.variants).filter((name) => State.shown.get(name));
  const withTruth = () => drive.truth && State.shown.get(TRUTH);

  const inner = () => Svg.inner(map, MARGIN);

  // View of all that is shown, with the same scale on both axes.
  function home() {
    const shown = [...new Set([choice.driver, ...names()]), ...(withTruth() ? [TRUTH] : [])];
    const x = Svg.padded(Svg.extremes(shown.flatMap(xs)) || [0, 1], 0.05, 0.5);
    const y = Svg.padded(Svg.extremes(shown.flatMap(ys)) || [0, 1], 0.05, 0.5);
    const { width, height } = inner();
    const scale = Math.max((x[1] - x[0]) / width, (y[1] - y[0]) / height);
    const about = ([low, high], size) => [(low + high - scale * size) / 2, (low + high + scale * size) / 2];
    return { x: about(x, width), y: about(y, height) };
  }

  // --- drawing -------------------------------------------------------------------------------------

  function draw() {
    const { svg } = map;
    if (!map.touched || !map.view) map.view = home();
    const { view } = map, { width, height } = inner();
    const k = map.scale = width / (view.x[1] - view.x[0]);
    const px = map.px = (x) => MARGIN.left + (x - view.x[0]) * k;
    const py = map.py = (y) => MARGIN.top + height - (y - view.y[0]) * k;
    const labels = { x: "x [m]", y: "y [m]" };
    const clipped = Svg.axes(map, MARGIN, { px, py, labels, spacing: 50, clip: "clip-map" });
    const inside = clipped();
    drawPaths(inside);
    make("rect", { class: "frame", x: MARGIN.left, y: MARGIN.top, width, height }, svg);
    map.marks = clipped();
    mark();
  }

  function drawPaths(parent) {
    const { px, py } = map, faint = choice.colouring ? 0.3 : 1;
    const line = (name, width, opacity) => make("path", { "data-series": name, fill: "none",
      d: Svg.linePath(xs(name), ys(name), px, py, breaks), stroke: State.colour({ series: name }),
      "stroke-width": width, "stroke-opacity": opacity, "stroke-linejoin": "round",
      "stroke-dasharray": State.dash({ series: name }) }, parent);
    if (withTruth()) line(TRUTH, 4, 0.65 * (choice.colouring ? 0.6 : 1));
    if (drive.fixes && State.shown.get(FIXES)) {
      let d = "";
      xs(FIXES).forEach((x, row) => {
        d += `M${(px(x) - 3).toFixed(1)} ${py(ys(FIXES)[row]).toFixed(1)}h6m-3-3v6`;
      });
      make("path", { d, stroke: State.colour({ series: FIXES }), "stroke-opacity": 0.6 }, parent);
    }
    for (const name of names()) {
      if (choice.colouring && name === choice.driver) continue;
      line(name, 1.6, faint);
      const row = xs(name).length - 1, [x, y] = [px(xs(name)[row]), py(ys(name)[row])];
      make("rect", { x: x - 4, y: y - 4, width: 8, height: 8, fill: State.colour({ series: name }),
        "fill-opacity": faint }, parent);
    }
    if (choice.colouring) drawColoured(parent);
    if (State.bands) drawEllipses(parent);
    const first = withTruth() ? TRUTH : choice.driver;
    const row = xs(first).findIndex((x) => x !== null);
    if (row >= 0) {
      const [x, y] = [px(xs(first)[row]), py(ys(first)[row])];
      make("circle", { class: "start", cx: x, cy: y, r: 6 }, parent);
      text("start", { class: "outlined", x: x + 9, y: y < 20 ? y + 16 : y - 6 }, parent);
    }
  }

  // The driver's own uncertainty along its path: ellipses of 3 sigma that the map has room for.
  function drawEllipses(parent) {
    const { x: [left, right] } = home();
    for (const [x, y, major, minor, turn] of drive.ellipses[choice.driver] || []) {
      if (6 * major > right - left) continue;
      make("ellipse", { class: "ellipse", rx: 3 * major * map.scale, ry: 3 * minor * map.scale,
        stroke: State.colour({ series: choice.driver }),
        transform: `translate(${map.px(x)} ${map.py(y)}) rotate(${-turn * 180 / Math.PI})` }, parent);
    }
  }

  // Range of a colouring for a variant: without the outermost 2 %, about zero if it has a sign.
  function rangeOf(colouring, name) {
    const values = columns[colouring.columns[name]] || [];
    const [low, high] = Svg.extremes(values, 0.02) || [0, 1];
    if (!colouring.signed) return [Math.min(0, low), Math.max(high, 1e-9)];
    const size = Math.max(Math.abs(low), Math.abs(high), 1e-9);
    return [-size, size];
  }

  function drawColoured(parent) {
    const { px, py } = map, { colouring, driver } = choice;
    const values = columns[colouring.columns[driver]], x = xs(driver), y = ys(driver);
    if (!values) return;
    const [low, high] = rangeOf(colouring, driver);
    const shapes = Array.from({ length: SHADES }, () => "");
    let unknown = "", all = "";
    for (let row = 1; row < x.length; row++) {
      if (breaks.has(row) || x[row] === null || x[row - 1] === null) continue;
      const step = `M${px(x[row - 1]).toFixed(1)} ${py(y[row - 1]).toFixed(1)}` +
        `L${px(x[row]).toFixed(1)} ${py(y[row]).toFixed(1)}`;
      if (values[row] === null) { unknown += step; continue; }
      all += step;
      const share = (values[row] - low) / (high - low);
      shapes[Math.min(SHADES - 1, Math.max(0, Math.floor(share * SHADES)))] += step;
    }
    const look = { fill: "none", "stroke-linecap": "round" };
    make("path", { ...look, d: all, class: "casing", "stroke-width": 6 }, parent);
    make("path", { ...look, d: unknown, class: "unknown", "stroke-width": 1.5 }, parent);
    shapes.forEach((d, number) => {
      const stroke = Svg.shade(scaleOf(colouring), (number + 0.5) / SHADES);
      if (d) make("path", { ...look, d, stroke, "stroke-width": 4 }, parent);
    });
  }

  const scaleOf = (colouring) => (colouring.signed ? "signed" : "unsigned");

  // Bar that says which colour is which value, in an element of its own.
  function drawBar() {
    map.bar.replaceChildren();
    const { colouring, driver } = choice;
    map.bar.hidden = !colouring;
    if (!colouring) return;
    const values = columns[colouring.columns[driver]];
    html("p", map.bar, values ? `${driver}: ${colouring.meaning} [${colouring.unit}]`
      : `${driver} has no values of this kind.`);
    if (!values) return;
    const width = Math.min(420, map.width), range = rangeOf(colouring, driver);
    const svg = make("svg", { viewBox: `0 0 ${width} 34`, height: 34, width }, map.bar);
    const place = (value) => 20 + (width - 40) * (value - range[0]) / (range[1] - range[0]);
    for (let number = 0; number < SHADES; number++) {
      make("rect", { x: 20 + (width - 40) * number / SHADES, y: 2, height: 12,
        width: (width - 40) / SHADES + 0.5, fill: Svg.shade(scaleOf(colouring), (number + 0.5) / SHADES) },
      svg);
    }
    for (const [value, label] of Svg.ticks(range, width / 80)) {
      make("line", { class: "frame", x1: place(value), x2: place(value), y1: 14, y2: 18 }, svg);
      text(label, { x: place(value), y: 31, "text-anchor": "middle" }, svg);
    }
  }

  // --- the robot -----------------------------------------------------------------------------------

  // The robot at the cursor: to scale, or as large as can be seen; the true place beside it.
  function mark() {
    map.marks.replaceChildren();
    if (State.cursor === null) return;
    const { px, py } = map, of = drive.variants[choice.driver];
    const [x, y] = [of.x, of.y].map((name) => State.at(name, State.cursor));
    const yaw = State.at(of.yaw, State.cursor, true);
    if (x === null || yaw === null) return;
    if (withTruth()) {
      const [there, far] = ["x_m", "y_m"].map((key) => State.at(`${TRUTH}/${key}`, State.cursor));
      if (there !== null && far !== null) {
        make("line", { class: "apart", x1: px(x), y1: py(y), x2: px(there), y2: py(far) }, map.marks);
        make("circle", { cx: px(there), cy: py(far), r: 5, fill: State.colour({ series: TRUTH }) },
          map.marks);
      }
    }
    const scale = Math.max(map.scale, LEAST_ROBOT / drive.length);
    const turn = `translate(${px(x)} ${py(y)}) rotate(${-yaw * 180 / Math.PI}) scale(${scale})`;
    const robot = make("g", { class: "robot", transform: turn }, map.marks);
    const { gauge, length } = drive, track = 0.22 * gauge;
    make("rect", { class: "hull", x: -0.45 * length, y: -0.5 * gauge, width: 0.9 * length,
      height: gauge }, robot);
    for (const side of [-1, 1]) {
      for (const [centre, size] of drive.contacts) {
        make("rect", { class: "track", x: centre - 0.5 * size, y: side * 0.5 * gauge - 0.5 * track,
          width: size, height: track }, robot);
      }
    }
    make("path", { class: "nose", d: `M${0.42 * length} 0l${-0.3 * length} ${-0.22 * gauge}v${0.44 * gauge}z` },
      robot);
  }

  // --- pointer -------------------------------------------------------------------------------------

  function zoom(factor, at) {
    const { view } = map, { width, height } = inner();
    const shares = [(at[0] - MARGIN.left) / width, 1 - (at[1] - MARGIN.top) / height];
    const about = (range, share) => {
      const size = range[1] - range[0], fixed = range[0] + share * size;
      const wanted = Math.min(Math.max(size / factor, 1e-3), 1e7);
      return [fixed - share * wanted, fixed + (1 - share) * wanted];
    };
    map.view = { x: about(view.x, shares[0]), y: about(view.y, shares[1]) };
    moved();
  }

  function pan(dx, dy) {
    const shift = (range, by) => range.map((edge) => edge + by);
    map.view = { x: shift(map.view.x, -dx / map.scale), y: shift(map.view.y, dy / map.scale) };
    moved();
  }

  function moved() {
    map.touched = true;
    map.reset.hidden = false;
    if (map.waiting) return;
    map.waiting = true;
    requestAnimationFrame(() => { map.waiting = false; draw(); });
  }

  function reset() {
    map.touched = false;
    map.reset.hidden = true;
    draw();
  }

  function place(event) {
    const box = map.svg.getBoundingClientRect(), scale = map.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  // Move the cursor to the row of the driver's path that is nearest to the pointer.
  function pick(event) {
    if (State.playing) return;
    const [x, y] = place(event), path = [xs(choice.driver), ys(choice.driver)];
    let best = -1, least = REACH ** 2;
    for (let row = 0; row < path[0].length; row++) {
      const far = (map.px(path[0][row]) - x) ** 2 + (map.py(path[1][row]) - y) ** 2;
      if (far < least) { least = far; best = row; }
    }
    if (best < 0) return;
    State.cursor = columns.t[best];
    State.change("cursor");
  }

  function listen() {
    const { svg } = map, fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return [Math.hypot(a[0] - b[0], a[1] - b[1]), [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]];
    };
    svg.addEventListener("pointerdown", (event) => {
      map.active = true;
      fingers.set(event.pointerId, place(event));
      try { svg.setPointerCapture(event.pointerId); } catch { /* it is gone already */ }
    });
    svg.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) { pick(event); return; }
      const now = place(event);
      if (fingers.size === 1) {
        fingers.set(event.pointerId, now);
        // One finger scrolls the page up and down, and finds a place on the path; two move the map.
        if (event.pointerType === "touch") { pick(event); return; }
        pan(now[0] - before[0], now[1] - before[1]);
      } else if (fingers.size === 2) {
        const [apart, middle] = spread();
        fingers.set(event.pointerId, now);
        const [wider, there] = spread();
        pan(there[0] - middle[0], there[1] - middle[1]);
        if (apart > 0 && wider > 0) zoom(wider / apart, there);
      }
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      svg.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    svg.addEventListener("pointerleave", () => { map.active = false; });
    svg.addEventListener("wheel", (event) => {
      // Who scrolls past the map moves the page; after a click on it, or with Ctrl, the wheel zooms.
      if (!event.ctrlKey && !map.active) return;
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), place(event));
    }, { passive: false });
    svg.addEventListener("dblclick", reset);
  }

  // --- the page ------------------------------------------------------------------------------------

  function measure() {
    map.width = Math.max(240, map.figure.clientWidth);
    map.height = Math.round(Math.min(0.75 * map.width, 0.72 * window.innerHeight, 620));
  }

  function start() {
    map.figure = document.getElementById("map");
    map.svg = make("svg", { class: "map", role: "img", "aria-label": "Paths in odom" }, map.figure);
    const buttons = html("div", map.figure, undefined, { class: "buttons" });
    const centre = () => [map.width / 2, map.height / 2];
    Svg.button("+", "zoom in", () => zoom(1.5, centre()), buttons);
    Svg.button("−", "zoom out", () => zoom(1 / 1.5, centre()), buttons);
    map.reset = Svg.button("Show all", "show all", reset, buttons);
    map.reset.hidden = true;
    map.bar = html("div", map.figure, undefined, { class: "bar" });
    html("figcaption", map.figure, "Squares: ends of the paths. Ellipses: the filter's own 3σ, if smaller than the map. Drag to move, click and " +
      "turn the wheel to zoom; on a touch screen with two fingers. Double-click for all. The robot is enlarged when zoomed out.");
    measure();
    listen();
    draw();
    drawBar();
    State.listen((what) => {
      if (what === "cursor") { mark(); return; }
      if (what === "range") return;
      if (what === "resize") { measure(); map.touched = false; }
      draw();
      drawBar();
    });
  }

  return { start, choice };
})();
