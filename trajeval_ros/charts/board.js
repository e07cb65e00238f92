// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// What the figures of a page share: the moment looked at, the stretch shown, who is shown and how.

/**
 * `estimates`: [{name, colour}], the colour a name of `pens.js`; `start`, `end`: s.
 *
 * Events, each for `on`: "cursor" (the moment has changed), "range" (the stretch), "brush" (one is
 * being chosen), "shown" (an estimate was switched, or aligned and raw), "theme".
 */
class Board {
  constructor({ start = 0, end = 1, estimates = [] } = {}) {
    this.whole = [start, Math.max(end, start + 1e-3)];
    this.range = [...this.whole];
    this.cursor = null;
    this.brush = null;
    this.raw = false;
    this.estimates = estimates;
    this.hidden = new Set();
    this.theme = new Theme();
    this.figures = [];
    this.listeners = new Map();
    const changed = () => {
      this.theme = new Theme();
      this.tell("theme");
    };
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  }

  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, []);
    this.listeners.get(event).push(listener);
  }

  tell(event) {
    for (const listener of this.listeners.get(event) ?? []) listener();
  }

  get span() {
    return this.range[1] - this.range[0];
  }

  get isZoomed() {
    return this.range[0] !== this.whole[0] || this.range[1] !== this.whole[1];
  }

  /** Look at a moment, s; null: at none. */
  setCursor(time) {
    this.cursor = time === null ? null : clamp(time, ...this.whole);
    this.tell("cursor");
  }

  /** Show a stretch and nothing else; the whole run without one. */
  setRange(begin = this.whole[0], end = this.whole[1]) {
    const least = 1e-5 * (this.whole[1] - this.whole[0]);
    const [low, high] = begin < end ? [begin, end] : [end, begin];
    const middle = 0.5 * (low + high);
    const half = Math.max(0.5 * (high - low), 0.5 * least);
    this.range = [
      Math.max(Math.min(low, middle - half), this.whole[0]),
      Math.min(Math.max(high, middle + half), this.whole[1]),
    ];
    this.tell("range");
  }

  /** The run has become longer, or begins later: what shows all of it goes on to. */
  setWhole(start, end) {
    const follows = !this.isZoomed;
    this.whole = [start, Math.max(end, start + 1e-3)];
    if (follows) this.range = [...this.whole];
    else this.range = this.range.map((time) => clamp(time, ...this.whole));
    if (!(this.span > 0)) this.range = [...this.whole];
    this.tell("range");
  }

  /** Zoom by a factor about the moment looked at; below 1: closer. */
  zoom(factor) {
    const [begin, end] = this.range;
    const seen = this.cursor !== null && this.cursor >= begin && this.cursor <= end;
    const about = seen ? this.cursor : 0.5 * (begin + end);
    this.setRange(about - factor * (about - begin), about + factor * (end - about));
  }

  setBrush(brush) {
    this.brush = brush;
    this.tell("brush");
  }

  /** Look at a moment of note: `around` seconds before and after it, where it is not seen well. */
  goTo(begin, end = begin, around = null) {
    const margin = around ?? Math.max(3 * (end - begin), 0.02 * (this.whole[1] - this.whole[0]));
    this.setRange(begin - margin, end + margin);
    this.setCursor(0.5 * (begin + end));
  }

  show(name, shown) {
    if (shown) this.hidden.delete(name);
    else this.hidden.add(name);
    this.tell("shown");
  }

  setRaw(raw) {
    this.raw = raw;
    this.tell("shown");
  }

  isShown(name) {
    return name === null || name === undefined || !this.hidden.has(name);
  }

  /** Move the moment by a share of what is shown, and what is shown with it. */
  step(share) {
    const time = this.cursor ?? (share > 0 ? this.range[0] : this.range[1]);
    this.moveTo(time + share * this.span);
  }

  moveTo(time) {
    const aim = clamp(time, ...this.whole);
    const [begin, end] = this.range;
    if (aim < begin) this.setRange(aim, aim + this.span);
    else if (aim > end) this.setRange(aim - this.span, aim);
    this.setCursor(aim);
  }

  /** What a key does; whether it does anything. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    const far = event.shiftKey ? 10 : 1;
    const actions = {
      ArrowLeft: () => this.step(-0.005 * far),
      ArrowRight: () => this.step(0.005 * far),
      PageDown: () => this.step(0.1),
      PageUp: () => this.step(-0.1),
      Home: () => this.moveTo(this.whole[0]),
      End: () => this.moveTo(this.whole[1]),
      "+": () => this.zoom(0.5),
      "=": () => this.zoom(0.5),
      "-": () => this.zoom(2),
      Escape: () => this.setRange(),
      0: () => this.setRange(),
    };
    const action = actions[event.key];
    if (action) action();
    return Boolean(action);
  }
}

/**
 * Let a pointer and keys move the board: hover looks, a drag chooses a stretch, a double click
 * shows all. `timeAt(event)`: the moment under the pointer, or null. `drags`: whether a drag is
 * for choosing.
 */
function drive(board, element, timeAt, drags = () => true) {
  let begun = null;
  element.addEventListener("pointermove", (event) => {
    const time = timeAt(event);
    if (time === null) return;
    board.setCursor(time);
    if (begun === null || event.pointerType === "touch" || !drags(event)) return;
    if (Math.hypot(event.clientX - begun.x, event.clientY - begun.y) > 5) {
      begun.moved = true;
      board.setBrush([begun.time, time]);
    }
  });
  element.addEventListener("pointerdown", (event) => {
    const time = timeAt(event);
    if (event.button !== 0 || time === null) return;
    begun = { x: event.clientX, y: event.clientY, time, moved: false };
    if (event.pointerType !== "touch") element.setPointerCapture(event.pointerId);
    board.setCursor(time);
  });
  const done = (event) => {
    const chosen = board.brush;
    const moved = begun !== null && begun.moved;
    begun = null;
    if (chosen) board.setBrush(null);
    if (moved && chosen && event.type === "pointerup" && chosen[0] !== chosen[1]) {
      board.setRange(...chosen);
    }
  };
  element.addEventListener("pointerup", done);
  element.addEventListener("pointercancel", done);
  element.addEventListener("dblclick", () => board.setRange());
}

/** Make an element one that keys move the moment with, and that says where it is. */
function makeSlider(board, element, label, say) {
  element.tabIndex = 0;
  element.setAttribute("role", "slider");
  element.setAttribute("aria-label", label);
  const tell = () => {
    const now = board.cursor ?? board.range[0];
    element.setAttribute("aria-valuemin", board.whole[0].toFixed(3));
    element.setAttribute("aria-valuemax", board.whole[1].toFixed(3));
    element.setAttribute("aria-valuenow", now.toFixed(3));
    element.setAttribute("aria-valuetext", say(now));
  };
  element.addEventListener("keydown", (event) => {
    if (board.key(event)) event.preventDefault();
  });
  board.on("cursor", () => { if (document.activeElement === element) tell(); });
  element.addEventListener("focus", tell);
  tell();
}
