// The page: starts its parts and connects the switches.
"use strict";
(() => {
  Drive.start();
  PathMap.start();
  document.body.dataset.drawn = String(Charts.start());

  for (const box of document.querySelectorAll(".toggles input")) {
    // A browser may remember from an earlier visit what was ticked.
    box.checked = State.shown.get(box.value);
    box.addEventListener("change", () => {
      State.shown.set(box.value, box.checked);
      State.change("all");
    });
  }
  const bands = document.getElementById("bands"), against = document.getElementById("against");
  const reset = document.getElementById("reset");
  bands.checked = State.bands;
  bands.addEventListener("change", () => { State.bands = bands.checked; State.change("all"); });
  against.value = State.against;
  against.addEventListener("change", () => {
    State.against = against.value;
    State.range = null;
    State.change("range");
  });
  reset.addEventListener("click", () => { State.range = null; State.change("range"); });
  State.listen(() => { reset.hidden = State.range === null; });

  // The page is long: its sections to choose from, below the bar that stays on top.
  const sections = [...document.querySelectorAll("h2")], go = document.getElementById("go");
  sections.forEach((one, number) => Svg.html("option", go, one.textContent, { value: number }));
  go.addEventListener("change", () => {
    if (go.value === "") return;
    const section = sections[Number(go.value)];
    const folded = section.closest("details");
    if (folded) folded.open = true;
    section.style.scrollMarginTop = `${document.querySelector(".toolbar").offsetHeight + 8}px`;
    section.scrollIntoView();
    go.value = "";
  });

  // Charts in a folded section have no width until it is opened; on paper all are.
  const folds = [...document.querySelectorAll("details.section")];
  for (const one of folds) one.addEventListener("toggle", () => State.change("fold"));
  window.addEventListener("beforeprint", () => folds.forEach((one) => { one.open = true; }));

  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    State.change("resize");
  });
})();
