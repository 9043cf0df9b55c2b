// What the page shows, and what its parts share: data, switches, the cursor in time, the range in view.
"use strict";
const State = (() => {
  const page = JSON.parse(document.getElementById("data").textContent);
  const parts = [];
  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const state = {
    page,
    columns: page.columns,
    looks: new Map(page.series.map((one) => [one.name, one])),
    shown: new Map(page.series.map((one) => [one.name, one.shown])),
    // "time" or "distance", bounds of that axis in view (null: all), the moment [s] that all parts mark.
    against: "time",
    range: null,
    cursor: null,
    // While the drive plays, pointing at a chart does not move the cursor.
    playing: false,
    bands: true,
    dark: night.matches,
  };

  // Parts of the page say what to do when something changes: "all", "range" or "cursor".
  state.listen = (part) => parts.push(part);
  state.change = (what) => { for (const part of parts) part(what); };
  night.addEventListener("change", () => { state.dark = night.matches; state.change("all"); });

  state.visible = (item) => item.series === undefined || state.shown.get(item.series);
  state.colour = (item) => {
    const look = state.look(item);
    return state.dark ? look.dark : look.colour;
  };
  state.look = (item) => (item.colour ? item : state.looks.get(item.series));
  state.dash = (item) => (item.series && state.looks.get(item.series).dash) || "";

  // Row of the last time up to t, -1 before the first.
  state.row = (times, t) => {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle + 1; else high = middle;
    }
    return low - 1;
  };

  // Rows before which a hole of the log ends; whether the log has nothing at t.
  const holes = new Set(page.breaks.t);
  state.inHole = (t) => {
    const times = state.columns.t, row = state.row(times, t);
    return holes.has(row + 1) && t > times[row];
  };

  // Value of a column of the page's common times at t; in a hole, that at its beginning.
  state.at = (name, t, isAngle = false) => {
    const times = state.columns.t, values = state.columns[name];
    if (!values) return null;
    const row = Math.max(0, state.row(times, t));
    const [before, after] = [values[row], values[row + 1]];
    if (before === null || after === null || after === undefined) return before;
    if (holes.has(row + 1)) return before;
    let step = after - before;
    if (isAngle) step -= 2 * Math.PI * Math.round(step / (2 * Math.PI));
    return before + step * Math.min(1, Math.max(0, (t - times[row]) / (times[row + 1] - times[row])));
  };

  // Column of times as the axis in use has it, and the way back.
  const known = new Map();
  state.along = (name) => {
    if (state.against === "time") return state.columns[name];
    if (name === "t") return state.columns.distance;
    if (!known.has(name)) known.set(name, state.columns[name].map((t) => state.at("distance", t)));
    return known.get(name);
  };
  state.place = (t) => (state.against === "time" ? t : state.at("distance", t));
  state.time = (x) => {
    if (state.against === "time") return x;
    const { t, distance } = state.columns, row = state.row(distance, x);
    if (row < 0) return t[0];
    if (row >= t.length - 1) return t[t.length - 1];
    const share = (x - distance[row]) / (distance[row + 1] - distance[row]);
    return t[row] + share * (t[row + 1] - t[row]);
  };
  state.axis = () => (state.against === "time" ? "time [s]" : "distance driven [m]");
  return state;
})();
