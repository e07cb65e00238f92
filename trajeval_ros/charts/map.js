// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// Trajectories in space: from above, from the side, or turned by hand.

const LEVELS = 24;
const REACH = 48;
const MOST_LABELS = 12;
const LABEL_HEIGHT = 14;
const LABEL_ROWS = 6;

/** Names of the colour of an error: 0 none, 1 the largest. */
function errorColour(share) {
  return share < 0.5 ? ["low", "middle", 2 * share] : ["middle", "high", 2 * share - 1];
}

/** Whether two boxes, {left, right, top, bottom}, have a place in common. */
function overlap(one, other) {
  return one.left < other.right && other.left < one.right
    && one.top < other.bottom && other.top < one.bottom;
}

/**
 * A map. `spec`:
 *   title, view ("top", "side" or "turn"), height (px);
 *   axes: {across, along, up: 0, 1 or 2, sign: of up}; origin: [x, y, z] that positions count from;
 *   way: {times, positions} of the whole ground truth, or null;
 *   tracks: [{estimate, label, colour, times, truth, aligned, raw, error, breaks}]: positions flat,
 *     x y z after one another; `raw`: null where it is not known; `error`: m, colours the track
 *     where there is one alone; `largest`: the error of the last colour;
 *   ellipsoids: [{time, place: [x, y, z], axes: [9 numbers]}]: columns of the axes, m, as they are
 *     to be drawn;
 *   marks: [{time, text, kind, estimate}]: kind "start", "end", "worst" or "event"; on the track of
 *     this estimate, or on the first.
 */
class MapView {
  constructor(board, host, spec) {
    this.board = board;
    this.host = host;
    this.spec = spec;
    this.yaw = -0.6;
    this.pitch = 0.55;
    host.classList.add("map");
    this.plot = document.createElement("div");
    this.plot.className = "plot";
    this.plot.style.height = `${spec.height ?? 420}px`;
    this.base = document.createElement("canvas");
    this.top = document.createElement("canvas");
    for (const canvas of [this.base, this.top]) canvas.setAttribute("aria-hidden", "true");
    this.plot.append(this.base, this.top);
    this.head = document.createElement("div");
    this.head.className = "head";
    this.head.innerHTML = `<span class="title">${escaped(spec.title)}</span>`
      + `<span class="hint"></span>`;
    this.printed = document.createElement("div");
    this.printed.className = "printed";
    host.replaceChildren(this.head, this.plot, this.printed);
    makeSlider(board, this.plot, `${spec.title}: the trajectories`, (time) => this.said(time));
    this.listen();
    board.figures.push(this);
    board.on("cursor", () => this.later("top"));
    for (const event of ["range", "shown", "theme", "brush"]) board.on(event, () => this.later("base"));
    new ResizeObserver(() => this.later("base")).observe(this.plot);
    this.later("base");
  }

  /** Show other data, of the same form. */
  update(spec) {
    this.spec = { ...this.spec, ...spec };
    this.later("base");
  }

  later(what) {
    this.waiting = this.waiting === "base" ? "base" : what;
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = null;
      const all = this.waiting === "base";
      this.waiting = null;
      if (all) this.drawBase();
      this.drawTop();
    });
  }

  listen() {
    const turns = this.spec.view === "turn";
    const mouse = (event) => {
      const box = this.plot.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    let held = null;
    drive(this.board, this.plot, (event) => {
      if (held !== null) return null;
      const found = this.nearest(...mouse(event));
      return found === null ? null : found.time;
    }, () => !turns);
    if (!turns) return;
    this.plot.classList.add("turns");
    this.plot.addEventListener("pointerdown", (event) => {
      if (event.button === 0) {
        held = mouse(event);
        this.plot.setPointerCapture(event.pointerId);
      }
    });
    this.plot.addEventListener("pointermove", (event) => {
      if (held === null) return;
      const [x, y] = mouse(event);
      this.turn(0.01 * (x - held[0]), 0.01 * (y - held[1]));
      held = [x, y];
    });
    for (const end of ["pointerup", "pointercancel"]) {
      this.plot.addEventListener(end, () => { held = null; });
    }
    this.plot.addEventListener("keydown", (event) => {
      const steps = { a: [-0.1, 0], d: [0.1, 0], w: [0, 0.1], s: [0, -0.1] };
      const step = event.ctrlKey || event.metaKey || event.altKey ? null : steps[event.key];
      if (step) {
        event.preventDefault();
        this.turn(...step);
      }
    });
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -0.1, 1.57);
    this.later("base");
  }

  // From space to the figure ------------------------------------------------------------------------

  /** Two numbers of a place before it is scaled: to the right, and up. */
  flat(positions, k) {
    const { across, along, up, sign } = this.spec.axes;
    const a = positions[3 * k + across];
    const b = positions[3 * k + along];
    const c = sign * positions[3 * k + up];
    if (this.spec.view === "top") return [a, b];
    if (this.spec.view === "side") return [this.sideways ? b : a, c];
    const cos = Math.cos(this.yaw);
    const sin = Math.sin(this.yaw);
    const depth = sin * a + cos * b;
    return [cos * a - sin * b, Math.cos(this.pitch) * c * this.stretch + Math.sin(this.pitch) * depth];
  }

  get shown() {
    return this.spec.tracks.filter((track) => this.board.isShown(track.estimate));
  }

  positions(track) {
    return this.board.raw && track.raw ? track.raw : track.aligned;
  }

  /** Find the scale by which what is shown fills the figure. */
  fit(width, height, above = 0) {
    const { board, spec } = this;
    const [begin, end] = board.range;
    const clouds = [];
    for (const track of this.shown) {
      const from = Math.max(lowerBound(track.times, begin) - 1, 0);
      const to = Math.min(lowerBound(track.times, end) + 1, track.times.length);
      if (to > from) clouds.push([track.truth, from, to], [this.positions(track), from, to]);
    }
    if (spec.way) {
      const from = lowerBound(spec.way.times, begin);
      const to = lowerBound(spec.way.times, end);
      if (to > from) clouds.push([spec.way.positions, from, to]);
    }
    this.setStretch(clouds);
    const low = [Infinity, Infinity];
    const high = [-Infinity, -Infinity];
    for (const [positions, from, to] of clouds) {
      for (let k = from; k < to; k += 1) {
        this.flat(positions, k).forEach((value, axis) => {
          if (value < low[axis]) low[axis] = value;
          if (value > high[axis]) high[axis] = value;
        });
      }
    }
    if (!(low[0] <= high[0])) [low[0], low[1], high[0], high[1]] = [0, 0, 1, 1];
    const turned = spec.view === "turn";
    const edge = turned ? { left: 12, right: 12, top: 10 + above, bottom: 10 }
      : { left: 44, right: 12, top: 10 + above, bottom: 24 };
    const room = [width - edge.left - edge.right, height - edge.top - edge.bottom];
    const spans = [0, 1].map((axis) => 1.12 * (high[axis] - low[axis]));
    const largest = Math.max(...spans) || 1;
    const scales = [0, 1].map((axis) => room[axis] / Math.max(spans[axis], 1e-3 * largest));
    const equal = Math.min(...scales);
    // Heights are small beside distances: where they would not be seen they are drawn larger.
    const vertical = spec.view === "side" ? Math.max(equal, Math.min(scales[1], 20 * equal)) : equal;
    this.exaggerated = spec.view === "side" ? vertical / equal : 1;
    const middle = [0, 1].map((axis) => 0.5 * (low[axis] + high[axis]));
    const centre = [edge.left + 0.5 * room[0], edge.top + 0.5 * room[1]];
    this.frame = {
      ...edge,
      width: room[0],
      height: room[1],
      scale: equal,
      x: (value) => centre[0] + equal * (value - middle[0]),
      y: (value) => centre[1] - vertical * (value - middle[1]),
      limits: [
        [middle[0] - 0.5 * room[0] / equal, middle[0] + 0.5 * room[0] / equal],
        [middle[1] - 0.5 * room[1] / vertical, middle[1] + 0.5 * room[1] / vertical],
      ],
    };
  }

  /** In the turned view heights are drawn larger where they are a small part of the whole. */
  setStretch(clouds) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (const [positions, from, to] of clouds) {
      for (let k = 3 * from; k < 3 * to; k += 1) {
        if (positions[k] < low[k % 3]) low[k % 3] = positions[k];
        if (positions[k] > high[k % 3]) high[k % 3] = positions[k];
      }
    }
    const { across, along, up, sign } = this.spec.axes;
    const extent = (axis) => high[axis] - low[axis];
    const widest = Math.max(extent(across), extent(along));
    this.sideways = extent(along) > extent(across);
    this.floor = sign > 0 ? low[up] : -high[up];
    this.box = { low, high };
    const wanted = 0.2 * widest / Math.max(extent(up), 1e-9);
    this.stretch = Number.isFinite(wanted) ? clamp(Math.round(wanted), 1, 10) : 1;
  }

  place(positions, k) {
    const [a, b] = this.flat(positions, k);
    return [this.frame.x(a), this.frame.y(b)];
  }

  // What is drawn -----------------------------------------------------------------------------------

  draw(pen) {
    const { spec, board } = this;
    if (spec.view !== "turn") this.grid(pen);
    const inside = this.frame;
    pen.clipped(inside.left - 8, inside.top - 8, inside.width + 16, inside.height + 16, () => {
      if (spec.view === "turn") this.ground(pen);
      if (spec.way) {
        this.path(pen, spec.way.positions, spec.way.times, [], { stroke: "way", dash: [1.5, 2.5] });
      }
      for (const track of this.shown) {
        this.path(pen, track.truth, track.times, track.breaks, { stroke: "truth", width: 3.4 });
      }
      for (const ellipsoid of spec.ellipsoids ?? []) this.ellipsoid(pen, ellipsoid);
      for (const track of this.shown) {
        if (track.error && spec.tracks.length === 1 && !board.raw) this.coloured(pen, track);
        else {
          const look = { stroke: track.colour, width: 1.7 };
          this.path(pen, this.positions(track), track.times, track.breaks, look);
        }
      }
      this.chosen(pen);
    });
    this.labels(pen);
  }

  /** A path; what lies outside of the stretch shown is faint. */
  path(pen, positions, times, breaks, look) {
    const inner = this.within(times);
    const piece = (from, to, alpha) => {
      const edges = [from, ...breaks.filter((k) => k > from && k < to), to];
      const found = [];
      for (let e = 1; e < edges.length; e += 1) {
        const points = [];
        for (let k = edges[e - 1]; k < edges[e]; k += 1) points.push(...this.place(positions, k));
        if (points.length > 2) found.push(points);
      }
      if (found.length) pen.lines(found, { ...look, alpha });
    };
    if (this.board.isZoomed) {
      piece(0, inner[0] + 1, 0.25);
      piece(inner[1] - 1, times.length, 0.25);
    }
    piece(...inner, 1);
  }

  within(times) {
    const [begin, end] = this.board.range;
    return [
      Math.max(lowerBound(times, begin) - 1, 0),
      Math.min(lowerBound(times, end) + 1, times.length),
    ];
  }

  coloured(pen, track) {
    const [first, last] = this.within(track.times);
    const largest = track.largest || 1e-9;
    const level = (k) => Math.min(Math.floor(LEVELS * Math.max(track.error[k - 1], track.error[k])
      / largest), LEVELS);
    if (this.board.isZoomed) {
      const look = { stroke: "low", width: 1.4 };
      this.path(pen, track.aligned, track.times, track.breaks, look);
    }
    // Stretches of one colour, by colour: what is far off is drawn last, and so on top.
    const broken = new Set(track.breaks);
    const byLevel = Array.from({ length: LEVELS + 1 }, () => []);
    let points = [];
    let now = -1;
    for (let k = first + 1; k < last; k += 1) {
      const next = broken.has(k) ? -1 : level(k);
      if (next !== now) {
        now = next;
        if (next >= 0) {
          points = [...this.place(track.aligned, k - 1)];
          byLevel[next].push(points);
        }
      }
      if (next >= 0) points.push(...this.place(track.aligned, k));
    }
    byLevel.forEach((stretches, k) => {
      const stroke = errorColour(Math.min((k + 0.5) / LEVELS, 1));
      if (stretches.length) pen.lines(stretches, { stroke, width: 2.2 });
    });
  }

  ellipsoid(pen, { place, axes }) {
    const centre = this.place(place, 0);
    // The outline of a turned ellipsoid: of the matrix of its projected axes, A A'.
    const columns = [0, 1, 2].map((k) => {
      const tip = place.map((value, axis) => value + axes[3 * axis + k]);
      const [x, y] = this.place(tip, 0);
      return [x - centre[0], y - centre[1]];
    });
    const sum = (i, j) => columns.reduce((total, column) => total + column[i] * column[j], 0);
    const [a, b, c] = [sum(0, 0), sum(0, 1), sum(1, 1)];
    const long = Math.sqrt(a) || 1e-9;
    const points = [];
    // Cholesky's factor turns a circle into the ellipse.
    const lower = [long, b / long, Math.sqrt(Math.max(c - (b / long) ** 2, 0))];
    for (let k = 0; k < 24; k += 1) {
      const [x, y] = [Math.cos((2 * Math.PI * k) / 24), Math.sin((2 * Math.PI * k) / 24)];
      points.push(centre[0] + lower[0] * x, centre[1] + lower[1] * x + lower[2] * y);
    }
    pen.area(points, { fill: "band", alpha: 0.3, stroke: "good", width: 0.5 });
  }

  chosen(pen) {
    const { brush } = this.board;
    if (!brush) return;
    const [begin, end] = brush[0] < brush[1] ? brush : [brush[1], brush[0]];
    for (const track of this.shown) {
      const points = [];
      for (let k = lowerBound(track.times, begin); k < lowerBound(track.times, end); k += 1) {
        points.push(...this.place(this.positions(track), k));
      }
      if (points.length > 2) pen.line(points, { stroke: "mark", width: 5, alpha: 0.5 });
    }
  }

  grid(pen) {
    const { spec, frame } = this;
    const bottom = frame.top + frame.height;
    const right = frame.left + frame.width;
    const { across, along, up, sign } = spec.axes;
    const names = spec.view === "top" ? [across, along] : [this.sideways ? along : across, up];
    for (const value of ticks(...frame.limits[0], Math.max(frame.width / 90, 2))) {
      pen.line([frame.x(value), frame.top, frame.x(value), bottom], { stroke: "grid" });
      pen.text(frame.x(value), bottom + 12, compact(value), { align: "center" });
    }
    for (const value of ticks(...frame.limits[1], Math.max(frame.height / 60, 2))) {
      pen.line([frame.left, frame.y(value), right, frame.y(value)], { stroke: "grid" });
      pen.text(frame.left - 6, frame.y(value), compact(value), { align: "right" });
    }
    const minus = spec.view === "side" && sign < 0 ? "−" : "";
    const axis = (k) => "xyz"[names[k]];
    const times = this.exaggerated.toFixed(this.exaggerated < 10 ? 1 : 0);
    const heights = this.exaggerated > 1.05 ? `, heights × ${times}` : "";
    const { origin = [0, 0, 0] } = spec;
    const from = names.some((k) => origin[k] !== 0)
      ? `, from ${names.map((k) => `${"xyz"[k]} ${origin[k]}`).join(", ")}` : "";
    this.hint = `${axis(0)} →  ${minus}${axis(1)} ↑  in metres${from}${heights}`;
  }

  /** A grid on the ground, and which way the axes go. */
  ground(pen) {
    const { across, along, up, sign } = this.spec.axes;
    const { low, high } = this.box;
    const point = (a, b) => {
      const at = [0, 0, 0];
      at[across] = a;
      at[along] = b;
      at[up] = sign * this.floor;
      return at;
    };
    const widest = Math.max(high[across] - low[across], high[along] - low[along]);
    const step = ticks(0, widest || 1, 6)[1] ?? 1;
    const from = (axis) => step * Math.floor(low[axis] / step);
    const to = (axis) => step * Math.ceil(high[axis] / step);
    for (let a = from(across); a <= to(across) + 1e-9 * step; a += step) {
      pen.line([...this.place(point(a, from(along)), 0), ...this.place(point(a, to(along)), 0)], {
        stroke: "grid",
      });
    }
    for (let b = from(along); b <= to(along) + 1e-9 * step; b += step) {
      pen.line([...this.place(point(from(across), b), 0), ...this.place(point(to(across), b), 0)], {
        stroke: "grid",
      });
    }
    const { frame } = this;
    const heights = this.stretch > 1 ? `, heights × ${this.stretch}` : "";
    this.hint = `squares of ${compact(step)} m${heights}; drag to turn`;
    const origin = this.flat([0, 0, 0], 0);
    [across, along, up].forEach((axis, k) => {
      const unit = [0, 0, 0];
      unit[axis] = k === 2 ? sign / this.stretch : 1;
      const [x, y] = this.flat(unit, 0).map((value, side) => 24 * (value - origin[side]));
      const [x0, y0] = [frame.left + frame.width - 34, frame.top + 34];
      pen.line([x0, y0, x0 + x, y0 - y], { stroke: "muted", width: 1.3 });
      const minus = k === 2 && sign < 0 ? "−" : "";
      pen.text(x0 + 1.4 * x, y0 - 1.4 * y, `${minus}${"xyz"[axis]}`, { align: "center" });
    });
  }

  /** Start, end, worst and events; those at one place share a label, and no label hides another. */
  labels(pen) {
    const placed = [];
    const marked = [];
    const { board } = this;
    for (const mark of this.spec.marks ?? []) {
      const track = mark.estimate
        ? this.shown.find((each) => each.estimate === mark.estimate) : this.shown[0];
      if (!track || mark.time < board.range[0] || mark.time > board.range[1]) continue;
      const k = nearest(track.times, mark.time);
      const [x, y] = this.place(this.positions(track), k);
      if (x < 0 || y < 0) continue;
      pen.circle(x, y, 4, { fill: "paper", stroke: mark.kind === "event" ? "mark" : "ink", width: 1.5 });
      marked.push({ left: x - 5, right: x + 5, top: y - 5, bottom: y + 5 });
      const near = placed.find((one) => Math.hypot(one.x - x, one.y - y) < 24);
      if (near) {
        if (!near.text.includes(mark.text)) near.text += `, ${mark.text}`;
      } else placed.push({ x, y, text: mark.text });
    }
    const taken = [...marked];
    for (const { x, y, text } of placed.slice(0, MOST_LABELS)) {
      const width = this.widthOf(text);
      const free = this.boxes(x, y, width).find((box) => !taken.some((other) => overlap(box, other)));
      if (!free) continue; // The list of moments names it still.
      taken.push(free);
      const middle = 0.5 * (free.top + free.bottom);
      const beside = free.left > x ? free.left - 2 : free.right + 2;
      if (Math.abs(middle - y) > LABEL_HEIGHT) {
        pen.line([x, y + 5 * Math.sign(middle - y), beside, middle], { stroke: "muted" });
      }
      pen.text(free.left, middle, text, { fill: "ink", halo: "paper" });
    }
  }

  /** Where the label of a mark may be within the figure, the best first: beside it, then further. */
  boxes(x, y, width) {
    const { frame } = this;
    const right = frame.left + frame.width;
    const toLeft = x > frame.left + 0.55 * frame.width;
    const found = [];
    for (let row = 0; row < LABEL_ROWS; row += 1) {
      for (const up of [-1, 1]) {
        for (const left of [toLeft, !toLeft]) {
          const begin = left ? x - 9 - width : x + 9;
          const middle = y + up * (9 + row * LABEL_HEIGHT);
          found.push({
            left: begin,
            right: begin + width,
            top: middle - 0.5 * LABEL_HEIGHT,
            bottom: middle + 0.5 * LABEL_HEIGHT,
          });
        }
      }
    }
    return found.filter((box) => box.left >= frame.left - 8 && box.right <= right + 8
      && box.top >= frame.top - 8 && box.bottom <= frame.top + frame.height + 8);
  }

  widthOf(text) {
    const context = this.base.getContext("2d");
    context.font = `400 11px ${this.board.theme.font}`;
    return context.measureText(text).width;
  }

  // On the screen -----------------------------------------------------------------------------------

  prepare(canvas) {
    const { clientWidth: width, clientHeight: height } = this.plot;
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    return new CanvasPen(context, this.board.theme);
  }

  drawBase() {
    const { clientWidth: width, clientHeight: height } = this.plot;
    if (width < 60) return;
    this.fit(width, height);
    this.draw(this.prepare(this.base));
    this.head.lastChild.textContent = this.hint;
  }

  drawTop() {
    if (!this.frame) return;
    const pen = this.prepare(this.top);
    const { cursor } = this.board;
    if (cursor === null) return;
    let below = null;
    for (const track of this.shown) {
      const k = entryAt(track.times, track.breaks, cursor);
      if (k < 0) continue;
      const truth = this.place(track.truth, k);
      const estimate = this.place(this.positions(track), k);
      pen.line([...truth, ...estimate], { stroke: "ink", width: 1.2 });
      pen.circle(...truth, 5, { fill: "paper", stroke: "ink", width: 1.6 });
      pen.circle(...estimate, 5, { fill: track.colour, stroke: "paper", width: 1.5 });
      below = below ?? truth;
    }
    const { way } = this.spec;
    if (below === null && way && way.times.length) {
      const place = this.place(way.positions, nearest(way.times, cursor));
      pen.circle(...place, 5, { fill: "paper", stroke: "muted", width: 1.6 });
    }
  }

  /** The pose that is drawn nearest to a point, if one is near. */
  nearest(x, y) {
    if (!this.frame) return null;
    let best = REACH ** 2;
    let time = null;
    const look = (positions, times) => {
      const [from, to] = this.within(times);
      for (let k = from; k < to; k += 1) {
        const [a, b] = this.place(positions, k);
        const away = (a - x) ** 2 + (b - y) ** 2;
        if (away < best) {
          best = away;
          time = times[k];
        }
      }
    };
    for (const track of this.shown) look(this.positions(track), track.times);
    if (time === null && this.spec.way) look(this.spec.way.positions, this.spec.way.times);
    return time === null ? null : { time };
  }

  said(time) {
    const parts = this.shown.map((track) => {
      const k = entryAt(track.times, track.breaks, time);
      if (k < 0) return `${track.label}: no pose`;
      const { origin = [0, 0, 0] } = this.spec;
      const at = [0, 1, 2].map((axis) => compact(
        origin[axis] + Number(track.truth[3 * k + axis].toPrecision(4)),
      ));
      const error = track.error ? `, off by ${reading(track.error[k], "m")}` : "";
      return `${track.label}: at ${at.join(", ")} m${error}`;
    });
    return [moment(time, this.board.span), ...parts].join("; ");
  }

  // On paper ----------------------------------------------------------------------------------------

  svg() {
    const pen = new SvgPen();
    const [width, height] = this.spec.view === "top" ? [PAPER_WIDTH, 420] : [PAPER_WIDTH / 2, 250];
    this.fit(width, height, 24);
    this.draw(pen);
    pen.text(0, 8, this.spec.title, { fill: "ink", size: 12, weight: 600 });
    pen.text(width - 12, 8, this.hint.replace("; drag to turn", ""), { align: "right" });
    this.later("base");
    return pen.svg(width, height, `${this.spec.title}: the trajectories`);
  }
}
