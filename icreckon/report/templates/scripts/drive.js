// The drive: the robot from above with its ICRs, a slider through time, and what the robot does then.
"use strict";
const Drive = (() => {
  // Time of the path and of the traces of the ICRs that is drawn behind the robot [s].
  const TRAIL = 8, TRACE = 6, TRACE_POINTS = 30;
  // Slowest turn that has an ICR in reach [rad/s].
  const LEAST_TURN = 0.02;
  // Usual length of a replay [s], and its speeds.
  const USUAL = 40, SPEEDS = [0.5, 1, 2, 5, 10, 20, 50, 100];
  const { make, text, html } = Svg;
  const { drive, columns } = { drive: State.page.drive, columns: State.columns };
  const { choice } = PathMap;
  const end = columns.t[columns.t.length - 1], begin = columns.t[0];
  const view = {}, player = {};

  const value = (key, t = State.cursor) => State.at(drive.variants[choice.driver][key], t, key === "yaw");

  // --- the robot from above ------------------------------------------------------------------------

  // Half the width that is seen [m]: the tracks' ICRs, without the outermost, and the robot.
  function reach() {
    const of = drive.variants[choice.driver];
    const sides = [...columns[of.left_y], ...columns[of.right_y]].map((one) => one && Math.abs(one));
    const widest = (Svg.extremes(sides, 0.02) || [0, 0])[1];
    const least = Math.max(1.1 * drive.gauge, 0.65 * drive.length);
    return Math.min(Math.max(1.25 * widest, least), 4 * drive.gauge);
  }

  function draw() {
    const { svg, width, height } = view;
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("height", height);
    const half = reach(), scale = width / (2 * half);
    // The robot looks up: x of base_link is up, y to the left.
    const px = (y) => width / 2 - y * scale, py = (x) => height / 2 - x * scale;
    Object.assign(view, { scale, px, py });
    drawRuler();
    drawTrail();
    drawRobot();
    drawIcrs();
    tell();
  }

  function drawRuler() {
    const { svg, width, height, scale } = view, step = Svg.stepOf(width / scale, 5);
    for (let k = Math.ceil(-width / scale / step); k * step < width / scale; k++) {
      make("line", { class: "grid", x1: view.px(k * step), x2: view.px(k * step), y1: 0, y2: height }, svg);
      make("line", { class: "grid", y1: view.py(k * step), y2: view.py(k * step), x1: 0, x2: width }, svg);
    }
    make("path", { class: "ruler", d: `M10 ${height - 12}h${step * scale}m0-4v8m${-step * scale}-8v8` }, svg);
    text(`${Number(step.toPrecision(3))} m`, { x: 16 + step * scale, y: height - 8 }, svg);
  }

  // The path just driven, as seen from the robot.
  function drawTrail() {
    const [x, y, yaw] = [value("x"), value("y"), value("yaw")];
    if (x === null || yaw === null) return;
    let d = "";
    for (let k = 0; k <= 60; k++) {
      const t = State.cursor - TRAIL * k / 60;
      if (t < begin) break;
      const [east, north] = [value("x", t), value("y", t)];
      if (east === null || north === null) break;
      const [dx, dy] = [east - x, north - y];
      const forward = Math.cos(yaw) * dx + Math.sin(yaw) * dy;
      const left = Math.cos(yaw) * dy - Math.sin(yaw) * dx;
      d += `${d ? "L" : "M"}${view.px(left).toFixed(1)} ${view.py(forward).toFixed(1)}`;
    }
    make("path", { class: "trail", d, stroke: State.colour({ series: choice.driver }) }, view.svg);
  }

  function drawRobot() {
    const { svg, scale, px, py } = view, { gauge, length } = drive, wide = 0.22 * gauge;
    make("rect", { class: "hull", x: px(0.5 * gauge), y: py(0.45 * length), width: gauge * scale,
      height: 0.9 * length * scale }, svg);
    make("path", { class: "nose", d: `M${px(0)} ${py(0.38 * length)}l${0.14 * gauge * scale} ` +
      `${0.16 * length * scale}h${-0.28 * gauge * scale}z` }, svg);
    for (const [side, key] of [[1, "left"], [-1, "right"]]) {
      const middle = 0.5 * side * gauge, speed = State.at(`inputs/${key}_m_s`, State.cursor);
      for (const [centre, size] of drive.contacts) {
        make("rect", { class: "track", x: px(middle + 0.5 * wide), y: py(centre + 0.5 * size), rx: 3,
          width: wide * scale, height: size * scale }, svg);
        drawTreads(middle, wide, travelled(key), centre, size);
      }
      if (speed === null) continue;
      const tip = py(speed * 0.6 * drive.base), from = py(0);
      if (Math.abs(tip - from) > 4) {
        const back = tip < from ? 7 : -7;
        make("path", { class: `arrow ${key}`, d: `M${px(middle)} ${from}V${tip}m-6 ${back}l6 ${-back}l6 ${back}` },
          svg);
      }
      text(`${Svg.number(speed)} m/s`, { class: "outlined", x: px(middle), y: py(-0.5 * length) + 16,
        "text-anchor": "middle" }, svg);
    }
  }

  // Treads that pass as the track or wheel runs.
  function drawTreads(middle, wide, way, centre, size) {
    const pitch = drive.length / 12, from = -centre - 0.5 * size;
    let d = "";
    for (let at = from + (((way % pitch) + pitch) % pitch); at < from + size; at += pitch) {
      d += `M${view.px(middle + 0.42 * wide).toFixed(1)} ${view.py(-at).toFixed(1)}h${(0.84 * wide * view.scale).toFixed(1)}`;
    }
    make("path", { class: "treads", d }, view.svg);
  }

  // Way of a track up to the cursor [m].
  function travelled(key) {
    if (!view[key]) {
      const speeds = columns[`inputs/${key}_m_s`], sums = [0];
      for (let row = 1; row < columns.t.length; row++) {
        const step = Math.min(columns.t[row] - columns.t[row - 1], 1);
        sums.push(sums[row - 1] + step * (speeds[row - 1] || 0));
      }
      view[key] = sums;
    }
    const row = Math.max(0, State.row(columns.t, State.cursor));
    const speed = columns[`inputs/${key}_m_s`][row] || 0;
    return view[key][row] + speed * Math.min(State.cursor - columns.t[row], 1);
  }

  function drawIcrs() {
    const { svg, px, py, width } = view;
    const [forward, left, right] = [value("icr_x"), value("left_y"), value("right_y")];
    const [v_x, v_y, w] = [value("v_x"), value("v_y"), value("w")];
    if (forward !== null && left !== null && right !== null) {
      drawTrace("left_y", "left");
      drawTrace("right_y", "right");
      make("line", { class: "line", x1: 0, x2: width, y1: py(forward), y2: py(forward) }, svg);
      for (const [y, key] of [[left, "left"], [right, "right"]]) drawIcr(y, forward, key);
    }
    drawTrueIcrs();
    if (w === null || Math.abs(w) < LEAST_TURN) return;
    const [y, x] = [v_x / w, -v_y / w], at = px(y);
    if (at > 14 && at < width - 14) {
      make("circle", { class: "vehicle", cx: at, cy: py(x), r: 7 }, svg);
      make("path", { class: "vehicle", d: `M${at - 11} ${py(x)}h22m-11-11v22` }, svg);
      text("ICR of the robot", { class: "outlined", x: Math.min(Math.max(at, 48), width - 48),
        y: py(x) - 14, "text-anchor": "middle" }, svg);
      return;
    }
    const edge = y > 0 ? 6 : width - 6, back = y > 0 ? 10 : -10, there = 32;
    make("path", { class: "vehicle", d: `M${edge + 2.4 * back} ${there}H${edge}m${back}-6l${-back} 6l${back} 6` },
      svg);
    text(`ICR of the robot: ${Svg.number(Math.abs(y))} m`, { class: "outlined", x: edge, y: there - 10,
      "text-anchor": y > 0 ? "start" : "end" }, svg);
  }

  function drawIcr(y, forward, key) {
    const { svg, px, py, width } = view, at = Math.min(Math.max(px(y), 8), width - 8);
    make("circle", { class: `icr ${key}`, cx: at, cy: py(forward), r: 6.5 }, svg);
    // Outside of the robot where there is room, else below.
    const isLeft = key === "left", hasRoom = (isLeft ? at : width - at) > 70;
    const x = hasRoom ? at + (isLeft ? -12 : 12) : Math.min(Math.max(at, 34), width - 34);
    const anchor = hasRoom ? (isLeft ? "end" : "start") : "middle", down = py(forward) + 20;
    text(`ICR ${key}`, { class: `outlined ${key}`, x, y: down, "text-anchor": anchor }, svg);
    text(`${Svg.number(Math.abs(y))} m`, { class: `outlined ${key}`, x, y: down + 14,
      "text-anchor": anchor }, svg);
  }

  // ICRs of the true motion, which a simulation knows while the robot turns.
  function drawTrueIcrs() {
    const forward = State.at("ground truth/icr_x_m", State.cursor);
    for (const key of ["left", "right"]) {
      const y = State.at(`ground truth/${key}_icr_y_m`, State.cursor);
      if (forward === null || y === null) continue;
      make("circle", { class: `true ${key}`, cx: view.px(y), cy: view.py(forward), r: 10 }, view.svg);
    }
  }

  // Where an ICR has been in the last seconds.
  function drawTrace(name, key) {
    for (let k = 1; k <= TRACE_POINTS; k++) {
      const t = State.cursor - TRACE * k / TRACE_POINTS;
      const [y, forward] = [value(name, t), value("icr_x", t)];
      if (t < begin || y === null || forward === null) return;
      make("circle", { class: `icr ${key}`, cx: view.px(y), cy: view.py(forward), r: 2.2,
        "fill-opacity": 0.7 * (1 - k / TRACE_POINTS), "stroke-opacity": 0 }, view.svg);
    }
  }

  // Words beside the picture: what the robot does at the cursor.
  function tell() {
    const [v_x, w] = [value("v_x"), value("w")];
    const time = `${State.cursor.toFixed(1)} s`;
    if (State.inHole(State.cursor)) {
      view.words.replaceChildren();
      html("dt", view.words, "time");
      html("dd", view.words, `${time}: a hole of the log; the robot as it was before`);
      return;
    }
    const rows = [["time", time],
      ["speed", `${Svg.number(v_x)} m/s`],
      ["yaw rate", `${Svg.number(w)} rad/s`],
      ["lateral acceleration", `${Svg.number(v_x === null || w === null ? null : v_x * w)} m/s²`]];
    const lost = State.at(`${choice.driver}/lost_rad_s`, State.cursor);
    if (lost !== null) rows.push(["slip in turning", `${Svg.number(lost)} rad/s`]);
    view.words.replaceChildren();
    for (const [name, label] of rows) {
      html("dt", view.words, name);
      html("dd", view.words, label);
    }
  }

  // --- the player ----------------------------------------------------------------------------------

  function go(t) {
    State.cursor = Math.min(end, Math.max(begin, t));
    State.change("cursor");
  }

  function step(now) {
    if (!State.playing) return;
    const passed = player.before === null ? 0 : (now - player.before) / 1000;
    player.before = now;
    let next = State.cursor + passed * Number(player.speed.value);
    // What is not in the log cannot be played.
    if (State.inHole(next)) next = columns.t[State.row(columns.t, next) + 1];
    go(next);
    if (State.cursor >= end) stop();
    else requestAnimationFrame(step);
  }

  function stop() {
    State.playing = false;
    player.play.textContent = "▶ Play";
  }

  function toggle() {
    if (State.playing) { stop(); return; }
    if (State.cursor >= end) go(begin);
    State.playing = true;
    player.before = null;
    player.play.textContent = "❚❚ Pause";
    requestAnimationFrame(step);
  }

  function chooser(label, entries, chosen, act, parent) {
    const box = html("label", parent, label + " "), select = html("select", box);
    entries.forEach(([key, label]) => html("option", select, label, { value: key }));
    select.value = chosen;
    select.addEventListener("change", () => act(select.value));
    return select;
  }

  function build() {
    const bar = document.getElementById("player");
    player.play = Svg.button("▶ Play", "play or pause the drive", toggle, bar);
    player.slider = html("input", bar, undefined, { type: "range", min: begin, max: end,
      step: Math.max((end - begin) / 5000, 1e-3), "aria-label": "time [s]" });
    player.slider.addEventListener("input", () => go(Number(player.slider.value)));
    player.clock = html("output", bar);
    const usual = SPEEDS.findLast((one) => one <= (end - begin) / USUAL) || SPEEDS[0];
    player.speed = chooser("speed", SPEEDS.map((one) => [one, `× ${one}`]), usual, () => {}, bar);
    const choices = document.getElementById("choices");
    chooser("robot by", Object.keys(drive.variants).map((name) => [name, name]), choice.driver, (name) => {
      choice.driver = name;
      State.change("drive");
    }, choices);
    const colours = [["", "variant"], ...drive.colourings.map((one, row) => [row, one.title])];
    chooser("path coloured by", colours, "", (row) => {
      choice.colouring = row === "" ? null : drive.colourings[Number(row)];
      State.change("drive");
    }, choices);
  }

  function measure() {
    view.width = Math.max(240, view.figure.clientWidth);
    view.height = Math.round(Math.min(1.05 * view.width, 480));
  }

  function follow() {
    player.slider.value = State.cursor;
    player.clock.textContent = `${State.cursor.toFixed(1)} of ${end.toFixed(0)} s`;
    draw();
  }

  // The moment of the strongest bend: there the ICRs are farthest from where they rest.
  function strongest() {
    const of = drive.variants[choice.driver];
    let best = 0, most = -1;
    columns[of.w].forEach((w, row) => {
      const force = w === null ? -1 : Math.abs(w * columns[of.v_x][row]);
      if (force > most && columns.t[row] > begin + TRAIL) { most = force; best = row; }
    });
    return columns.t[best];
  }

  function start() {
    view.figure = document.getElementById("robot");
    view.svg = make("svg", { class: "above", role: "img", "aria-label": "The robot from above" }, view.figure);
    view.words = html("dl", view.figure, undefined, { class: "words" });
    State.cursor = strongest();
    build();
    measure();
    follow();
    State.listen((what) => {
      if (what === "range") return;
      if (what === "resize") measure();
      follow();
    });
  }

  return { start };
})();
