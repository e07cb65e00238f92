// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// The page of `watch`: keeps the state that the server sends, and shows it.
"use strict";

// The figures are drawn anew so often at the most, ms; and the stretch of "last minute", s.
const PERIOD = 500;
const LAST = 60;
const COLOURS = 8;

const element = (id) => document.getElementById(id);

function make(tag, text = "", attributes = {}) {
  const made = document.createElement(tag);
  if (text !== "") made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

// What is known -----------------------------------------------------------------------------------

/** The state as the messages make it; see feed.py for what is in one. */
class State {
  constructor() {
    this.run = null;
    this.sections = {};
    this.curves = {};
  }

  /** Take in a message; return the names of the sections that it brought. */
  take(message) {
    if (message.whole || message.run !== this.run) {
      this.run = message.run;
      this.sections = {};
      this.curves = {};
    }
    Object.assign(this.sections, message.sections);
    for (const [name, { columns, from, rows, tail }] of Object.entries(message.curves)) {
      const known = this.curves[name] ?? { rows: [] };
      known.rows.length = Math.min(from, known.rows.length);
      known.rows.push(...rows);
      this.curves[name] = { columns, rows: known.rows, tail };
    }
    return Object.keys(message.sections);
  }

  get estimates() {
    return this.sections.run?.estimates ?? [];
  }

  /** First and last moment of all curves. */
  get span() {
    const ends = Object.values(this.curves).flatMap(({ rows, tail }) => {
      const last = tail ?? rows[rows.length - 1];
      return last ? [(rows[0] ?? last)[0], last[0]] : [];
    });
    const way = this.sections["path/ground_truth"]?.seconds ?? [];
    if (way.length) ends.push(way[0], way[way.length - 1]);
    return ends.length ? [Math.min(...ends), Math.max(...ends)] : [0, 0];
  }

  /** Curves of an estimate by their names, `seconds` among them. */
  columns(what, name) {
    const curves = this.curves[`${what}/${name}`];
    if (!curves) return { seconds: [] };
    const rows = curves.tail ? [...curves.rows, curves.tail] : curves.rows;
    return Object.fromEntries(
      curves.columns.map((column, k) => [column, rows.map((row) => row[k] ?? NaN)]),
    );
  }
}

/** Indices before which a line is broken: there was nothing for long. */
function breaksOf(times) {
  const steps = times.slice(1).map((time, k) => time - times[k]);
  const usual = [...steps].sort((a, b) => a - b)[steps.length >> 1] ?? 0;
  const long = Math.max(10 * usual, 0.5);
  return steps.flatMap((step, k) => (step > long ? [k + 1] : []));
}

/** What all but the largest fiftieth stay below: in a gap the ground truth is a guess itself. */
function usualLargest(errors) {
  const sorted = [...errors].sort((a, b) => a - b);
  return Math.max(sorted[Math.floor(0.98 * (sorted.length - 1))] ?? 0, 1e-9);
}

// What is shown -----------------------------------------------------------------------------------

const CHARTS = [
  { id: "translation", title: "Absolute error", unit: "m", what: "errors", column: "translation_error", band: "translation_band", zero: true, log: false, wide: true, height: 200 },
  { id: "rotation", title: "Absolute error", unit: "°", what: "errors", column: "rotation_error", band: "rotation_band", zero: true, log: false, wide: true, height: 160 },
  { id: "ate", title: "ATE so far", unit: "m", what: "figures", column: "ate_translation", zero: true },
  { id: "re", title: "RE so far", unit: "m", what: "figures", column: "re_translation", zero: true },
  { id: "accuracy", title: "Accuracy in the window", unit: "m", what: "figures", column: "accuracy_translation", zero: true },
  { id: "clock", title: "Clock offset in the window", unit: "ms", what: "figures", column: "clock_offset", whiskers: "clock_offset_std", levels: [{ value: 0 }] },
  { id: "nats", title: "Likelihood of a step in the window", unit: "nats", what: "figures", column: "relative_nats_per_pose" },
  { id: "chi2", title: "χ²/dof of the steps in the window", unit: "", what: "figures", column: "relative_chi2_per_dof", log: true },
];
const FACTORS = { "°": 180 / Math.PI, ms: 1e3 };

class Page {
  constructor() {
    this.state = new State();
    this.names = "";
    this.last = false;
    this.drawn = 0;
    this.waiting = null;
    this.changed = new Set();
  }

  take(message) {
    for (const name of this.state.take(message)) this.changed.add(name);
    const wait = Math.max(0, this.drawn + PERIOD - performance.now());
    this.waiting ??= setTimeout(() => {
      this.waiting = null;
      this.drawn = performance.now();
      this.show();
    }, wait);
  }

  show() {
    const { sections, estimates } = this.state;
    this.showConnection(sections.connection);
    element("main").hidden = estimates.length === 0;
    if (estimates.length === 0) return;
    const begins = this.names !== JSON.stringify(estimates);
    if (begins) this.begin(estimates);
    const changed = (name) => begins || this.changed.has(name);
    this.showRun(sections.run);
    if (estimates.some((name) => changed(`estimate/${name}`))) this.showEstimates();
    if (changed("comparison")) this.showComparison(sections.comparison ?? []);
    if (changed("health")) this.showHealth(sections.health);
    this.changed.clear();
    this.showTime();
    this.showCharts();
    this.showMaps();
  }

  /** A run of these estimates: figures of their own. */
  begin(estimates) {
    this.names = JSON.stringify(estimates);
    this.board = new charts.Board({
      estimates: estimates.map((name, k) => ({ name, colour: `e${k % COLOURS}` })),
    });
    this.charts = new Map();
    element("charts").replaceChildren();
    this.maps = null;
    charts.controls(this.board, element("bar"), {
      clock: (time) => {
        const { start } = this.state.sections.run;
        return start > 1e9 ? new Date(1e3 * (start + time)).toLocaleTimeString() : "";
      },
    });
    const last = make("button", "last minute", { type: "button", "aria-pressed": "false" });
    last.addEventListener("click", () => {
      this.last = !this.last;
      if (!this.last) this.board.setRange();
      this.showTime();
    });
    this.board.on("range", () => {
      const [, end] = this.board.range;
      const follows = this.last && Math.abs(this.board.span - LAST) < 1 && end === this.board.whole[1];
      if (this.last && !this.moving && !follows) this.last = false;
      last.setAttribute("aria-pressed", String(this.last));
    });
    element("bar").append(last);
    charts.printable(this.board);
  }

  showConnection(connection) {
    const { state, text } = connection;
    element("connection").dataset.state = state;
    if (element("connection").textContent !== text) element("connection").textContent = text;
  }

  showRun({ node, start, number }) {
    const [begin, end] = this.state.span;
    const date = start > 1e9 ? `, since ${new Date(1e3 * start).toLocaleString()}` : "";
    const again = number > 0 ? `, run ${number + 1}` : "";
    element("run").textContent = `${node}: ${(end - begin).toFixed(1)} s${again}${date}`;
    document.title = `${node}: live evaluation`;
  }

  showEstimates() {
    const { sections, estimates } = this.state;
    const several = estimates.length > 1;
    element("estimates").replaceChildren(...estimates.map((name, k) => {
      const card = make("article", "", { class: "estimate", "data-name": name });
      const { tiles = [], answer = [] } = sections[`estimate/${name}`] ?? {};
      if (several) {
        const title = make("h2");
        title.append(make("i", "", { style: `background:var(--e${k % COLOURS})` }), name);
        card.append(title);
      }
      const row = make("div", "", { class: "tiles" });
      for (const { title, value, remark } of tiles) {
        const tile = make("div", "", { class: "tile" });
        tile.append(make("span", title, { class: "name" }), make("b", value), make("span", remark));
        row.append(tile);
      }
      card.append(row);
      if (answer.length) {
        const list = make("dl", "", { class: "answer" });
        for (const { title, text } of answer) list.append(make("dt", title), make("dd", text));
        card.append(list);
      }
      return card;
    }));
    this.showFigures();
  }

  showFigures() {
    if (!element("figures").parentElement.open) return;
    const { sections, estimates } = this.state;
    const tables = estimates.flatMap((name) => {
      const statuses = sections[`estimate/${name}`]?.figures ?? {};
      return Object.entries(statuses).map(([status, figures]) => {
        const body = make("tbody");
        for (const [key, value] of Object.entries(figures)) {
          const row = make("tr");
          row.append(make("td", key), make("td", String(value), { class: "n" }));
          body.append(row);
        }
        const table = make("table");
        table.append(body);
        const block = make("section");
        block.append(make("h3", estimates.length > 1 ? `${name}: ${status}` : status), table);
        return block;
      });
    });
    element("figures").replaceChildren(...tables);
  }

  showComparison(pairs) {
    element("comparison").hidden = pairs.length === 0;
    element("comparison").replaceChildren(
      ...pairs.map(({ pair, text }) => make("li", pairs.length > 1 ? `${pair}: ${text}.` : `${text}.`)),
    );
  }

  showHealth({ now, events }) {
    element("health").replaceChildren(...now.map(({ name, level, text }) => {
      const row = make("tr");
      row.append(
        make("td", level, { class: `level ${level}` }),
        make("td", name, { class: "name" }),
        make("td", text),
      );
      return row;
    }));
    element("events-title").hidden = events.length === 0;
    element("events").replaceChildren(...[...events].reverse().map(({ seconds, level, text }) => {
      const item = make("li");
      const button = make("button", "", { type: "button" });
      button.append(
        make("time", `${seconds.toFixed(1)} s`),
        make("span", level, { class: level }),
        make("span", text),
      );
      button.addEventListener("click", () => this.board.goTo(seconds));
      item.append(button);
      return item;
    }));
  }

  /** The run has become longer. */
  showTime() {
    const [start, end] = this.state.span;
    this.moving = true;
    const [begin, until] = this.board.whole;
    if (begin !== start || until !== end) this.board.setWhole(start, end);
    if (this.last) this.board.setRange(Math.max(end - LAST, start), end);
    this.moving = false;
  }

  showCharts() {
    for (const chart of CHARTS) {
      const spec = this.specOf(chart);
      const known = this.charts.get(chart.id);
      if (known) known.update(spec);
      else if (spec.lines.length) {
        const host = make("div", "", { id: `chart-${chart.id}` });
        if (chart.wide) host.className = "wide";
        const places = CHARTS.map(({ id }) => id);
        const next = [...element("charts").children].find(
          (child) => places.indexOf(child.id.slice(6)) > places.indexOf(chart.id),
        );
        element("charts").insertBefore(host, next ?? null);
        this.charts.set(chart.id, new charts.TimeChart(this.board, host, spec));
      }
    }
  }

  specOf({ title, unit, what, column, band, whiskers, zero, log, height, levels }) {
    const factor = FACTORS[unit] ?? 1;
    const lines = [];
    const bands = [];
    this.state.estimates.forEach((name, k) => {
      const columns = this.state.columns(what, name);
      const { seconds } = columns;
      const values = (columns[column] ?? []).map((value) => factor * value);
      if (!values.some(Number.isFinite)) return;
      const colour = `e${k % COLOURS}`;
      // A figure of the run stays what it is where nothing comes.
      const breaks = what === "errors" ? breaksOf(seconds) : [];
      // In a gap of the ground truth an error says little: the curve may leave the frame there.
      const known = band ? columns[band] : [];
      const finite = known.filter(Number.isFinite).sort((a, b) => a - b);
      const usual = finite[finite.length >> 1];
      const limits = values.map((value, n) => (known[n] > 10 * usual ? NaN : value));
      lines.push({ label: name, estimate: name, colour, times: seconds, values, limits, breaks });
      const spread = (columns[band ?? whiskers] ?? []).map((value) => factor * value);
      const there = seconds.map((_, n) => n).filter((n) => Number.isFinite(spread[n] + (band ? 0 : values[n])));
      const times = there.map((n) => seconds[n]);
      if (band && bands.length === 0 && times.length) {
        bands.push({
          label: "ground truth known to, 2 σ", estimate: null, colour: "band", times, low: null,
          high: there.map((n) => spread[n]), breaks: breaksOf(times),
        });
      }
      if (whiskers && times.length) {
        bands.push({
          label: "±", estimate: name, colour, alpha: 0.2, counts: true, times, breaks: [],
          low: there.map((n) => values[n] - spread[n]),
          high: there.map((n) => values[n] + spread[n]),
        });
      }
    });
    return { title, unit, lines, bands, zero, log, height: height ?? 150, levels: levels ?? [] };
  }

  showMaps() {
    const { sections, estimates } = this.state;
    const way = sections["path/ground_truth"];
    if (!way) return;
    const tracks = estimates.flatMap((name, k) => {
      const path = sections[`path/${name}`];
      return path ? [{
        estimate: name,
        label: name,
        colour: `e${k % COLOURS}`,
        times: path.seconds,
        truth: path.truth,
        aligned: path.aligned,
        raw: null,
        error: path.error,
        largest: usualLargest(path.error),
        breaks: breaksOf(path.seconds),
      }] : [];
    });
    if (tracks.length === 0) return;
    const spec = {
      axes: way.axes,
      way: { times: way.seconds, positions: way.positions },
      tracks,
      ellipsoids: [],
      marks: [],
    };
    if (this.maps) for (const map of this.maps) map.update(spec);
    else {
      const height = 340;
      this.maps = [
        new charts.MapView(this.board, element("top"), { ...spec, title: "From above", view: "top", height }),
        new charts.MapView(this.board, element("turn"), { ...spec, title: "In space", view: "turn", height }),
      ];
    }
  }
}

// What is heard -----------------------------------------------------------------------------------

const page = new Page();
let source = null;

/** Listen while the page is seen: one that is hidden costs nothing, and is told all when it is. */
function listen() {
  if (document.hidden || source !== null) return;
  source = new EventSource("events");
  source.onmessage = (event) => page.take(JSON.parse(event.data));
  source.onerror = () => {
    page.showConnection({ state: "lost", text: "watch has ended, or cannot be reached; trying again" });
  };
  source.onopen = () => {
    const { connection } = page.state.sections;
    if (connection) page.showConnection(connection);
  };
}

function leave() {
  source?.close();
  source = null;
}

document.addEventListener("visibilitychange", () => (document.hidden ? leave() : listen()));
window.addEventListener("pagehide", leave);
window.addEventListener("pageshow", listen);
element("figures").parentElement.addEventListener("toggle", () => page.showFigures());
listen();
