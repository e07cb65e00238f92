// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// The bar by which a person switches, zooms and goes to moments of note; and printing.

/**
 * Fill a bar. `raw`: whether there is something to show unaligned; `clock(time)`: what a moment is
 * called besides its seconds; `moments`: [{begin, end, text, kind}], to go to; of one with `times`
 * each click goes to the next.
 */
function controls(board, host, { raw = false, clock = () => "", moments = [] } = {}) {
  host.classList.add("controls");
  const group = (label) => {
    const element = document.createElement("div");
    element.setAttribute("role", "group");
    element.setAttribute("aria-label", label);
    return element;
  };
  const button = (text, label, action) => {
    const element = document.createElement("button");
    element.type = "button";
    element.textContent = text;
    element.setAttribute("aria-label", label);
    element.addEventListener("click", action);
    return element;
  };
  const estimates = group("Estimates");
  for (const { name, colour } of board.estimates) {
    const label = document.createElement("label");
    label.innerHTML = `<input type="checkbox" checked><i style="background:var(--${colour})"></i>`
      + escaped(name);
    label.firstChild.addEventListener("change", (event) => board.show(name, event.target.checked));
    estimates.append(label);
  }
  const how = group("Alignment");
  if (raw) {
    for (const [text, value] of [["aligned", false], ["raw", true]]) {
      const element = button(text, `Poses: ${text}`, () => board.setRaw(value));
      element.setAttribute("aria-pressed", String(board.raw === value));
      board.on("shown", () => element.setAttribute("aria-pressed", String(board.raw === value)));
      how.append(element);
    }
    how.className = "switch";
  }
  const zoom = group("Time shown");
  const all = button("all", "Show all of the run", () => board.setRange());
  zoom.append(
    button("−", "Zoom out", () => board.zoom(2)),
    button("+", "Zoom in", () => board.zoom(0.5)),
    all,
  );
  zoom.className = "switch";
  const now = document.createElement("output");
  const tell = () => {
    all.disabled = !board.isZoomed;
    const time = board.cursor;
    const called = time === null ? "" : clock(time);
    now.textContent = time === null ? "point at a figure"
      : `${moment(time, board.span)}${called ? ` · ${called}` : ""}`;
  };
  now.setAttribute("aria-live", "off");
  for (const event of ["cursor", "range"]) board.on(event, tell);
  tell();
  host.replaceChildren(...[estimates, how, zoom, now].filter((each) => each.childNodes.length));
  if (moments.length) host.append(momentList(board, moments, button));
}

function momentList(board, moments, button) {
  const list = document.createElement("div");
  list.className = "moments";
  list.setAttribute("role", "group");
  list.setAttribute("aria-label", "Moments of note");
  for (const { begin, end, text, kind, times } of moments) {
    const next = () => times.find((time) => time > (board.cursor ?? -Infinity) + 1e-9) ?? times[0];
    const go = times ? () => board.goTo(next()) : () => board.goTo(begin, end);
    const element = button(text, `Go to: ${text}`, go);
    if (!times) element.title = `at ${moment(begin, board.span)}`;
    element.className = kind;
    list.append(element);
  }
  return list;
}

/** On paper every figure is vectors, and nothing is folded up. */
function printable(board) {
  let opened = [];
  const draw = () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const each of opened) each.open = true;
    for (const figure of board.figures) figure.printed.innerHTML = figure.svg();
  };
  const clear = () => {
    for (const each of opened) each.open = false;
    for (const figure of board.figures) figure.printed.replaceChildren();
  };
  window.addEventListener("beforeprint", draw);
  window.addEventListener("afterprint", clear);
}
