// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// Curves over time, drawn by uPlot on the screen and by a pen on paper.

const PAPER_WIDTH = 720;

/**
 * A chart of curves over time. `spec`:
 *   title, unit ("m", "°", "" or none), note (a line below), height (px), log (whether by default),
 *   zero (the axis begins there), least (a value that the axis is to reach);
 *   lines: [{label, estimate, colour, times, values, raw, breaks, width, dash, kind}]: `estimate`
 *     the name by which it is switched, or null; `raw`: the values where poses are not aligned
 *     (null: there are none); `limits`: the values that the axis is to reach, where not all; `kind` "line", "step" (a value holds until the next) or "dots";
 *   bands: [{label, estimate, colour, times, low, high, breaks, counts}]: an array each, or null for
 *     the bottom; `counts`: whether the axis is to reach them; whiskers: [{estimate, colour, times, low, high}];
 *   levels: [{value, label}]; shades: [[begin, end], ...] without ground truth;
 *   marks: [{time, text, colour}], triangles at the top, which one can click.
 * Arrays are sorted by `times`, s.
 */
class TimeChart {
  constructor(board, host, spec) {
    this.board = board;
    this.host = host;
    host.classList.add("chart");
    this.head = document.createElement("div");
    this.head.className = "head";
    this.plot = document.createElement("div");
    this.plot.className = "plot";
    this.printed = document.createElement("div");
    this.printed.className = "printed";
    host.replaceChildren(this.head, this.plot, this.printed);
    this.spec = spec;
    this.log = Boolean(spec.log);
    makeSlider(board, this.plot, `${spec.title} over time`, (time) => this.said(time));
    this.build();
    board.figures.push(this);
    board.on("cursor", () => this.showCursor());
    board.on("brush", () => this.showBrush());
    board.on("range", () => this.redraw());
    board.on("shown", () => this.rebuild());
    board.on("theme", () => this.redraw());
    new ResizeObserver(() => this.resize()).observe(this.plot);
  }

  /** Show other data, of the same form. */
  update(spec) {
    const looks = () => JSON.stringify([...this.drawn, ...this.bands].map(
      ({ label, colour, kind, width, dash }) => [label, colour, kind, width, dash],
    ));
    const before = looks();
    this.spec = { ...this.spec, ...spec };
    const data = this.columns();
    if (looks() !== before) this.rebuild();
    else {
      // The same curves, further on: what the pointer is doing there goes on, too.
      this.u.setData(data);
      this.showCursor();
    }
  }

  // What is shown ---------------------------------------------------------------------------------

  get lines() {
    const { board } = this;
    return this.spec.lines
      .filter((line) => board.isShown(line.estimate) && !(board.raw && line.raw === null))
      .map((line) => (board.raw && line.raw ? { ...line, values: line.raw } : line));
  }

  get bands() {
    return (this.spec.bands ?? []).filter((band) => this.board.isShown(band.estimate));
  }

  get whiskers() {
    return (this.spec.whiskers ?? []).filter((each) => this.board.isShown(each.estimate));
  }

  /** Smallest and largest value to be seen in the stretch that is shown. */
  limits() {
    const [begin, end] = this.board.range;
    let low = Infinity;
    let high = -Infinity;
    const take = (times, values) => {
      const from = Math.max(lowerBound(times, begin) - 1, 0);
      const to = Math.min(lowerBound(times, end) + 1, times.length);
      for (let k = from; k < to; k += 1) {
        const value = values[k];
        if (Number.isFinite(value) && (!this.log || value > 0)) {
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
    };
    for (const line of this.lines) take(line.times, line.limits ?? line.values);
    for (const each of [...this.whiskers, ...this.bands.filter((band) => band.counts)]) {
      take(each.times, each.low);
      take(each.times, each.high);
    }
    if (this.spec.least !== undefined && (!this.log || this.spec.least > 0)) {
      low = Math.min(low, this.spec.least);
      high = Math.max(high, this.spec.least);
    }
    if (low > high) return this.log ? [0.1, 1] : [0, 1];
    if (this.log) return [low / 1.5, high * 1.5];
    if (this.spec.zero) return [0, high > 0 ? 1.08 * high : 1];
    const margin = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
    return [low - margin, high + margin];
  }

  /** Columns as uPlot takes them: one array of times, null where a line is broken. */
  columns() {
    const tables = [];
    const byTimes = new Map();
    const order = [];
    for (const line of this.lines) {
      const key = line.times;
      if (!byTimes.has(key)) {
        byTimes.set(key, { breaks: line.breaks ?? [], lines: [] });
      }
      byTimes.get(key).lines.push(line);
    }
    for (const [times, { breaks, lines }] of byTimes) {
      const cut = (values, between) => {
        const found = [];
        let next = 0;
        for (let k = 0; k < times.length; k += 1) {
          if (breaks[next] === k) {
            found.push(between(k));
            next += 1;
          }
          found.push(Number.isFinite(values[k]) ? values[k] : null);
        }
        return found;
      };
      tables.push([
        cut(times, (k) => 0.5 * (times[k - 1] + times[k])),
        ...lines.map((line) => cut(this.positive(line.values), () => null)),
      ]);
      order.push(...lines);
    }
    this.drawn = order;
    if (!tables.length) return [[...this.board.whole]];
    return tables.length === 1 ? tables[0] : uPlot.join(tables, tables.map((table) => table.map(() => 2)));
  }

  positive(values) {
    return this.log ? values.map((value) => (value > 0 ? value : NaN)) : values;
  }

  // On the screen ---------------------------------------------------------------------------------

  build() {
    const { board, spec } = this;
    const data = this.columns();
    const tick = (size) => ({
      stroke: () => board.theme.colour("muted"),
      font: `11px ${board.theme.font}`,
      grid: { stroke: () => board.theme.colour("grid"), width: 1 },
      ticks: { show: false },
      size,
      gap: 4,
    });
    this.u = new uPlot({
      width: Math.max(this.plot.clientWidth, 200),
      height: spec.height ?? 170,
      padding: [10, 18, 0, 0],
      legend: { show: false },
      cursor: { show: false },
      scales: {
        x: { time: false, range: () => [...board.range] },
        y: { distr: this.log ? 3 : 1, range: () => this.limits() },
      },
      axes: [
        { ...tick(24), values: (u, values) => values.map(compact) },
        {
          ...tick(52),
          ...(this.log ? {
            splits: (u, axis, low, high) => logTicks(low, high, 6),
            filter: (u, splits) => splits,
          } : {}),
          values: (u, values) => values.map((value) => (value === null ? "" : compact(value))),
        },
      ],
      series: [
        {},
        ...this.drawn.map((line) => ({
          stroke: () => board.theme.colour(line.colour),
          width: line.kind === "dots" ? 0 : line.width ?? 1.5,
          dash: line.dash,
          paths: line.kind === "step" ? uPlot.paths.stepped({ align: 1 }) : undefined,
          points: {
            show: line.kind === "dots",
            size: 6,
            fill: () => board.theme.colour(line.colour),
          },
        })),
      ],
      hooks: { drawClear: [(u) => this.drawBehind(u)], draw: [(u) => this.drawAbove(u)] },
    }, data, this.plot);
    this.overlay();
    this.fillHead();
    this.showCursor();
    this.u.root.addEventListener("click", (event) => this.click(event));
  }

  rebuild() {
    this.u.destroy();
    this.build();
  }

  redraw() {
    this.u.batch(() => {
      this.u.setScale("x", { min: this.board.range[0], max: this.board.range[1] });
    });
    this.showCursor();
  }

  resize() {
    const width = this.plot.clientWidth;
    if (width > 0 && Math.abs(width - this.u.width) > 1) {
      this.u.setSize({ width, height: this.u.height });
      this.showCursor();
    }
  }

  frameOf(u) {
    const ratio = uPlot.pxRatio;
    const box = {
      left: u.bbox.left / ratio,
      top: u.bbox.top / ratio,
      width: u.bbox.width / ratio,
      height: u.bbox.height / ratio,
    };
    return {
      ...box,
      x: (time) => box.left + u.valToPos(time, "x"),
      y: (value) => box.top + u.valToPos(value, "y"),
      limits: [u.scales.y.min, u.scales.y.max],
    };
  }

  onCanvas(u, draw) {
    const { ctx } = u;
    ctx.save();
    ctx.setTransform(uPlot.pxRatio, 0, 0, uPlot.pxRatio, 0, 0);
    draw(new CanvasPen(ctx, this.board.theme), this.frameOf(u));
    ctx.restore();
  }

  drawBehind(u) {
    this.onCanvas(u, (pen, frame) => {
      pen.clipped(frame.left, frame.top, frame.width, frame.height, () => this.behind(pen, frame));
    });
  }

  drawAbove(u) {
    this.onCanvas(u, (pen, frame) => this.above(pen, frame));
  }

  overlay() {
    const { board } = this;
    const over = this.u.over;
    this.now = document.createElement("div");
    this.now.className = "now";
    this.brush = document.createElement("div");
    this.brush.className = "brush";
    this.spots = this.drawn.map((line) => {
      const spot = document.createElement("div");
      spot.className = "spot";
      spot.style.background = `var(--${line.colour})`;
      return spot;
    });
    over.append(this.brush, this.now, ...this.spots);
    over.classList.add("over");
    drive(board, over, (event) => {
      const left = event.clientX - over.getBoundingClientRect().left;
      return clamp(this.u.posToVal(left, "x"), ...board.range);
    });
  }

  /** A click on a triangle, or just below it, goes there. */
  click(event) {
    const box = this.u.over.getBoundingClientRect();
    const x = event.clientX - box.left;
    const y = event.clientY - box.top;
    if (y < -12 || y > 6) return;
    const away = (mark) => Math.abs(this.u.valToPos(mark.time, "x") - x);
    const near = (this.spec.marks ?? []).filter((mark) => away(mark) < 6);
    if (near.length) this.board.goTo(near.sort((a, b) => away(a) - away(b))[0].time);
  }

  fillHead() {
    const { spec } = this;
    const title = document.createElement("span");
    title.className = "title";
    title.textContent = spec.unit ? `${spec.title}, ${spec.unit}` : spec.title;
    const legend = document.createElement("span");
    legend.className = "legend";
    this.readings = this.drawn.map((line) => {
      const entry = document.createElement("span");
      entry.className = "entry";
      entry.innerHTML = `<i class="${line.kind === "dots" ? "dot" : "stroke"}"`
        + ` style="background:var(--${line.colour})"></i>${escaped(line.label)} <b></b>`;
      legend.append(entry);
      return entry.querySelector("b");
    });
    const named = new Set();
    for (const band of this.bands) {
      if (!named.has(band.label)) {
        named.add(band.label);
        const entry = document.createElement("span");
        entry.className = "entry";
        entry.innerHTML = `<i class="area" style="background:var(--${band.colour})"></i>`
          + `${escaped(band.label)} <b></b>`;
        legend.append(entry);
        this.readings.push(entry.querySelector("b"));
      }
    }
    this.head.replaceChildren(title, legend);
    if (spec.log !== undefined) {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "scale";
      button.textContent = "log";
      button.setAttribute("aria-pressed", String(this.log));
      button.setAttribute("aria-label", `log axis: ${spec.title}`);
      button.addEventListener("click", () => {
        this.log = !this.log;
        this.rebuild();
        this.head.querySelector("button").focus();
      });
      this.head.append(button);
    }
  }

  showCursor() {
    const { board, u } = this;
    const time = board.cursor;
    const seen = time !== null && time >= board.range[0] && time <= board.range[1];
    this.now.hidden = !seen;
    if (seen) this.now.style.left = `${u.valToPos(time, "x")}px`;
    this.drawn.forEach((line, k) => {
      const index = time === null ? -1 : this.indexOf(line, time);
      const value = index < 0 ? null : line.values[index];
      this.readings[k].textContent = time === null ? "" : reading(value, this.spec.unit);
      const place = value === null ? NaN : u.valToPos(value, "y");
      const shown = seen && line.kind !== "dots" && place >= 0 && place <= u.over.clientHeight;
      this.spots[k].hidden = !shown;
      if (shown) {
        const at = line.kind === "step" ? time : line.times[index];
        this.spots[k].style.transform = `translate(${u.valToPos(at, "x")}px, ${place}px)`;
      }
    });
    const named = [...new Set(this.bands.map((band) => band.label))];
    named.forEach((label, k) => {
      const band = this.bands.find((each) => each.label === label);
      const index = time === null ? -1 : entryAt(band.times, band.breaks ?? [], time);
      const shown = index >= 0 && band.low === null;
      this.readings[this.drawn.length + k].textContent = shown
        ? reading(band.high[index], this.spec.unit) : "";
    });
  }

  indexOf(line, time) {
    if (line.kind === "step") {
      const index = lowerBound(line.times, time);
      return index < line.times.length && line.times[index] === time ? index : index - 1;
    }
    return entryAt(line.times, line.breaks ?? [], time);
  }

  showBrush() {
    const { brush } = this.board;
    this.brush.hidden = brush === null;
    if (brush === null) return;
    const [a, b] = brush.map((time) => this.u.valToPos(time, "x"));
    this.brush.style.left = `${Math.min(a, b)}px`;
    this.brush.style.width = `${Math.abs(b - a)}px`;
  }

  said(time) {
    const values = (this.drawn ?? []).map((line) => {
      const index = this.indexOf(line, time);
      return `${line.label} ${reading(index < 0 ? null : line.values[index], this.spec.unit)}`;
    });
    return [moment(time, this.board.span), ...values].join(", ");
  }

  // On both ---------------------------------------------------------------------------------------

  behind(pen, frame) {
    const bottom = frame.top + frame.height;
    const right = frame.left + frame.width;
    for (const [begin, end] of this.spec.shades ?? []) {
      const a = Math.max(frame.x(begin), frame.left);
      const b = Math.min(frame.x(end), right);
      if (b > a) {
        pen.area([a, frame.top, b, frame.top, b, bottom, a, bottom], { fill: "gap", alpha: 1 });
      }
    }
    const y = (value) => (this.log && !(value > 0) ? bottom + 9
      : clamp(frame.y(value), frame.top - 9, bottom + 9));
    for (const band of this.bands) {
      for (const [from, to] of this.pieces(band)) {
        const points = [];
        for (let k = from; k < to; k += 1) points.push(frame.x(band.times[k]), y(band.high[k]));
        for (let k = to - 1; k >= from; k -= 1) {
          points.push(frame.x(band.times[k]), band.low === null ? bottom + 9 : y(band.low[k]));
        }
        if (to - from > 1) pen.area(points, { fill: band.colour, alpha: band.alpha ?? 0.55 });
      }
    }
    for (const { value } of this.spec.levels ?? []) {
      const at = frame.y(value);
      pen.line([frame.left, at, right, at], { stroke: "axis", width: 1 });
    }
  }

  above(pen, frame) {
    const right = frame.left + frame.width;
    pen.clipped(frame.left, frame.top, frame.width, frame.height, () => {
      for (const each of this.whiskers) {
        each.times.forEach((time, k) => {
          const x = frame.x(time);
          pen.line([x, frame.y(each.low[k]), x, frame.y(each.high[k])], { stroke: each.colour });
        });
      }
    });
    for (const { time, colour = "mark" } of this.spec.marks ?? []) {
      const x = frame.x(time);
      if (x >= frame.left - 0.5 && x <= right + 0.5) {
        const top = frame.top;
        pen.area([x - 4.5, top - 8, x + 4.5, top - 8, x, top], { fill: colour });
      }
    }
  }

  /** Stretches [from, to) of what is shown of a band or line, one point more on each side. */
  pieces(drawn) {
    const [begin, end] = this.board.range;
    const first = Math.max(lowerBound(drawn.times, begin) - 1, 0);
    const last = Math.min(lowerBound(drawn.times, end) + 1, drawn.times.length);
    const inner = (drawn.breaks ?? []).filter((index) => index > first && index < last);
    const edges = [first, ...inner, last];
    return edges.slice(1).map((edge, k) => [edges[k], edge]);
  }

  // On paper --------------------------------------------------------------------------------------

  /** The chart as SVG, as wide as a page. */
  svg() {
    const { board, spec } = this;
    const names = this.drawn.map((line) => [line.label, line.colour, line.kind]);
    for (const band of this.bands) {
      if (!names.some(([label]) => label === band.label)) names.push([band.label, band.colour, "area"]);
    }
    const frame = { left: 56, top: 44, width: PAPER_WIDTH - 66, height: (spec.height ?? 170) - 30 };
    const total = frame.top + frame.height + 24;
    const [low, high] = this.limits();
    const along = (value, a, b) => (value - a) / (b - a);
    const share = this.log
      ? (value) => along(Math.log(value), Math.log(low), Math.log(high))
      : (value) => along(value, low, high);
    frame.x = (time) => frame.left + frame.width * along(time, ...board.range);
    frame.y = (value) => frame.top + frame.height * (1 - share(value));
    frame.limits = [low, high];
    const pen = new SvgPen();
    const title = spec.unit ? `${spec.title}, ${spec.unit}` : spec.title;
    pen.text(0, 8, `${title}${this.log ? " (logarithmic)" : ""}`, {
      fill: "ink", size: 12, weight: 600,
    });
    this.svgLegend(pen, names);
    const bottom = frame.top + frame.height;
    for (const value of ticks(...board.range, 8)) {
      const x = frame.x(value);
      pen.line([x, frame.top, x, bottom], { stroke: "grid" });
      pen.text(x, bottom + 12, compact(value), { align: "center" });
    }
    for (const value of this.log ? logTicks(low, high, 6) : ticks(low, high, 4)) {
      const y = frame.y(value);
      pen.line([frame.left, y, frame.left + frame.width, y], { stroke: "grid" });
      pen.text(frame.left - 6, y, compact(value), { align: "right" });
    }
    pen.clipped(frame.left, frame.top, frame.width, frame.height, () => {
      this.behind(pen, frame);
      for (const line of this.drawn) this.svgLine(pen, frame, line);
    });
    this.above(pen, frame);
    return pen.svg(PAPER_WIDTH, total, `${title} over time`);
  }

  svgLegend(pen, names) {
    let x = 56;
    for (const [label, colour, kind] of names) {
      const thick = kind === "area" ? 8 : kind === "dots" ? 5 : 2;
      pen.line([x, 23, x + 14, 23], { stroke: colour, width: thick });
      pen.text(x + 19, 23, label, { size: 10.5 });
      x += 34 + 5.6 * label.length;
    }
  }

  svgLine(pen, frame, line) {
    for (const [from, to] of this.pieces(line)) {
      const points = [];
      for (let k = from; k < to; k += 1) {
        const value = line.values[k];
        if (!Number.isFinite(value) || (this.log && !(value > 0))) continue;
        const x = frame.x(line.times[k]);
        if (line.kind === "dots") pen.circle(x, frame.y(value), 3, { fill: line.colour });
        if (line.kind === "step" && points.length) points.push(x, points[points.length - 1]);
        points.push(x, frame.y(value));
      }
      if (line.kind !== "dots" && points.length > 2) {
        pen.line(points, { stroke: line.colour, width: line.width ?? 1.3, dash: line.dash ?? [] });
      }
    }
  }
}
