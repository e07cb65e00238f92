// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// The figures of the report, from the data that lie in the page (payload.py).
(() => {
  "use strict";
  const { Board, TimeChart, MapView, controls, printable, floats } = charts;
  const data = JSON.parse(document.getElementById("data").textContent);
  const board = new Board({ start: 0, end: data.end, estimates: data.estimates });
  window.board = board;
  const single = data.estimates.length === 1;

  /** A figure that fails costs itself alone, and says so. */
  function draw(id, make) {
    const host = document.getElementById(id);
    if (!host) return;
    try {
      make(host);
    } catch (error) {
      host.textContent = `This figure could not be drawn: ${error.message}`;
      console.error(error);
    }
  }

  function lengths(vectors) {
    return Float32Array.from({ length: vectors.length / 3 }, (_, k) => (
      Math.hypot(vectors[3 * k], vectors[3 * k + 1], vectors[3 * k + 2])));
  }

  function component(vectors, axis) {
    return Float32Array.from({ length: vectors.length / 3 }, (_, k) => vectors[3 * k + axis]);
  }

  function between(a, b) {
    return a.map((value, k) => value - b[k]);
  }

  /** Positions as the estimate has them: R' (p - t) / s, from the map's origin. */
  function unaligned(aligned, { rotation: r, translation: t, scale }) {
    const { origin } = data;
    const found = new Float64Array(aligned.length);
    for (let k = 0; k < aligned.length; k += 3) {
      const d = [0, 1, 2].map((axis) => aligned[k + axis] + origin[axis] - t[axis]);
      for (let axis = 0; axis < 3; axis += 1) {
        const turned = r[axis] * d[0] + r[3 + axis] * d[1] + r[6 + axis] * d[2];
        found[k + axis] = turned / scale - origin[axis];
      }
    }
    return found;
  }

  const estimates = data.estimates.map((one) => {
    const truth = floats(one.truth);
    const off = floats(one.off);
    const aligned = Float64Array.from(off, (value, k) => value + truth[k]);
    const raw = unaligned(aligned, one.alignment);
    return {
      ...one,
      times: floats(one.times),
      truth,
      aligned,
      raw,
      off,
      rawOff: between(raw, truth),
      translation: lengths(off),
      turned: one.rotationAxes ? floats(one.rotationAxes) : null,
    };
  });

  // Which are shown, and where to go ----------------------------------------------------------------

  const way = data.way && {
    times: floats(data.way.times),
    positions: floats(data.way.positions),
    lengths: floats(data.way.lengths),
  };

  /** How far the ground truth has gone by then. */
  function clock(time) {
    if (!way) return "";
    const gone = way.lengths[charts.nearest(way.times, time)];
    return `${charts.reading(gone, "m")} along the ground truth`;
  }

  const moments = [...data.moments];
  if (data.anew.length) {
    const times = data.anew.length === 1 ? "" : ` (${data.anew.length})`;
    moments.push({ text: `ground truth learned anew${times}`, kind: "learned", times: data.anew });
  }
  draw("controls", (host) => controls(board, host, { raw: true, clock, moments }));

  // Where -------------------------------------------------------------------------------------------

  const tracks = estimates.map((one) => ({
    estimate: one.name,
    label: one.name,
    colour: one.colour,
    times: one.times,
    truth: one.truth,
    aligned: one.aligned,
    raw: one.raw,
    error: one.translation,
    largest: one.largest,
    breaks: one.breaks,
  }));
  const ends = single
    ? [
      { time: tracks[0].times[0], text: "start", kind: "start" },
      { time: tracks[0].times[tracks[0].times.length - 1], text: "end", kind: "end" },
    ]
    : [];
  const spots = data.moments.filter(({ kind }) => kind === "worst" || kind === "jump" || kind === "clock");
  const marks = [
    ...ends,
    ...spots.filter(({ kind }) => single || kind === "worst").map(({ begin, end, text, kind, estimate }) => ({
      time: 0.5 * (begin + end),
      text: kind === "jump" ? "jump" : text,
      kind: kind === "worst" ? "worst" : "event",
      estimate,
    })),
  ];
  for (const [id, title, view, height] of [
    ["top", "From above", "top", 430],
    ["side", "From the side", "side", 190],
    ["turn", "In space", "turn", 210],
  ]) {
    draw(id, (host) => new MapView(board, host, {
      title, view, height, axes: data.axes, origin: data.origin, way, tracks, marks,
      ellipsoids: data.ellipsoids,
    }));
  }

  // What is not drawn is said.
  const thinned = data.estimates.filter(({ poses: [drawn, of] }) => drawn < of);
  if (thinned.length) {
    const said = thinned.map(({ name, poses: [drawn, of] }) => (
      `${drawn.toLocaleString("en")} of the ${of.toLocaleString("en")} poses${single ? "" : ` of ${name}`}`));
    const note = document.createElement("p");
    note.className = "caption";
    note.textContent = `Drawn: ${said.join(", ")}, the extremes of every curve among them.`;
    document.querySelector(".maps")?.after(note);
  }

  // Over time ---------------------------------------------------------------------------------------

  const events = data.moments
    .filter(({ kind }) => kind !== "gap" && kind !== "lost")
    .map(({ begin, end, text }) => ({ time: 0.5 * (begin + end), text }));
  const common = { shades: data.gaps, marks: events };

  function lines(values, raw) {
    return estimates.map((one) => ({
      label: single ? "error" : one.name,
      estimate: one.name,
      colour: one.colour,
      times: one.times,
      breaks: one.breaks,
      values: values(one),
      raw: raw(one),
    })).filter((line) => line.values !== null);
  }

  function bands(name) {
    return estimates.map((one) => ({
      label: "ground truth known to, 2 σ",
      estimate: one.name,
      colour: "band",
      alpha: 0.6 / estimates.length + 0.1,
      times: one.times,
      breaks: one.breaks,
      low: null,
      high: floats(one[name]),
    }));
  }

  function axes(values, raw) {
    return estimates.flatMap((one) => (values(one) === null ? [] : [0, 1, 2].map((axis) => ({
      label: single ? "xyz"[axis] : `${one.name} ${"xyz"[axis]}`,
      estimate: one.name,
      colour: "xyz"[axis],
      width: 1.2,
      dash: [undefined, [6, 3], [2, 2]][estimates.indexOf(one) % 3],
      times: one.times,
      breaks: one.breaks,
      values: component(values(one), axis),
      raw: raw(one) === null ? null : component(raw(one), axis),
    }))));
  }

  function chart(id, spec) {
    if (spec.lines.length) draw(id, (host) => new TimeChart(board, host, { ...common, ...spec }));
    else document.getElementById(id)?.remove();
  }

  const { kind } = data;
  chart("translation", {
    title: `Translation, ${kind}`, unit: "m", zero: true, height: 200,
    log: data.logarithmic.translation,
    lines: lines((one) => one.translation, (one) => lengths(one.rawOff)),
    bands: bands("translationBand"),
  });
  chart("rotation", {
    title: `Rotation, ${kind}`, unit: "°", zero: true, height: 180,
    log: data.logarithmic.rotation,
    lines: lines(
      (one) => one.turned && lengths(one.turned),
      (one) => one.rawRotation && floats(one.rawRotation),
    ),
    bands: bands("rotationBand"),
  });
  chart("translation-axes", {
    title: "Translation along the world's axes", unit: "m", height: 150, levels: [{ value: 0 }],
    lines: axes((one) => one.off, (one) => one.rawOff),
  });
  chart("rotation-axes", {
    title: "Rotation about the world's axes", unit: "°", height: 150, levels: [{ value: 0 }],
    lines: axes((one) => one.turned, () => null),
  });
  const { up, sign } = data.axes;
  chart("height", {
    title: `Height: ${sign < 0 ? "−" : ""}${"xyz"[up]}`, unit: "m", height: 150,
    lines: [
      ...estimates.slice(0, 1).map((one) => ({
        label: "ground truth", estimate: null, colour: "way", width: 3, times: one.times,
        breaks: one.breaks,
        values: component(one.truth, up).map((value) => sign * (value + data.origin[up])),
      })),
      ...lines(
        (one) => component(one.aligned, up).map((value) => sign * (value + data.origin[up])),
        (one) => Array.from(component(one.raw, up), (value) => sign * (value + data.origin[up])),
      ).map((line) => ({ ...line, label: single ? "estimate" : line.label })),
    ],
  });

  // The clock ---------------------------------------------------------------------------------------

  const clocks = estimates.filter((one) => one.clock.length > 1).map((one) => ({
    label: single ? "offset of a stretch" : one.name,
    estimate: one.name,
    colour: one.colour,
    kind: "dots",
    times: one.clock.map(({ time }) => time),
    values: one.clock.map(({ offset }) => offset),
    low: one.clock.map(({ offset, std }) => offset - 2 * std),
    high: one.clock.map(({ offset, std }) => offset + 2 * std),
  }));
  chart("clock", {
    title: "Clock offset, ± 2 σ", unit: "ms", height: 160, lines: clocks, whiskers: clocks,
    levels: [{ value: 0 }], least: 0,
  });

  // The ground truth --------------------------------------------------------------------------------

  chart("rates", {
    title: "Messages a second", unit: "", height: 150, zero: true,
    marks: [...events, ...data.anew.map((time) => ({
      time, text: "learned anew", colour: "good",
    }))].sort((a, b) => a.time - b.time),
    lines: data.rates.map(({ label, colour, estimate, times, rates }) => ({
      label, colour, estimate, kind: "step", times: floats(times), values: floats(rates),
    })),
  });

  // Likelihoods -------------------------------------------------------------------------------------

  function likelihoods(relative, absolute) {
    return estimates.flatMap((one) => [
      [relative, "relative", one.colour, 2.6],
      [absolute, "absolute", single ? "e1" : one.colour, 1.1],
    ].filter(([name]) => one.likelihood[name]).map(([name, label, colour, width]) => ({
      label: single ? label : `${one.name}, ${label}`,
      estimate: one.name,
      colour,
      width,
      dash: single || label === "relative" ? undefined : [5, 3],
      times: one.likelihood.decoded,
      values: floats(one.likelihood[name]),
    })));
  }
  for (const one of estimates) one.likelihood.decoded = floats(one.likelihood.times);
  chart("likelihood", {
    title: "Log-likelihood since the start", unit: "nats", height: 150,
    lines: likelihoods("relative", "absolute"),
  });
  chart("likelihood-window", {
    title: `Log-likelihood gained within ${data.window} s, given all before`, unit: "nats", height: 150,
    lines: likelihoods("windowRelative", "windowAbsolute"),
  });
  chart("chi2", {
    title: `χ²/dof gained within ${data.window} s, given all before`, unit: "", height: 160, log: true,
    levels: [{ value: 1 }], least: 1,
    lines: estimates.filter((one) => one.likelihood.chi2).map((one) => ({
      label: single ? "relative" : one.name,
      estimate: one.name,
      colour: one.colour,
      times: one.likelihood.decoded,
      values: floats(one.likelihood.chi2),
    })),
    bands: estimates.filter((one) => one.likelihood.usual).map(({ name, likelihood: { usual } }) => ({
      label: "as good as the ground truth (99 % of such windows)",
      estimate: name,
      colour: "band",
      times: floats(usual.times),
      low: floats(usual.low),
      high: floats(usual.high),
    })),
  });
  printable(board);
  document.documentElement.classList.add("drawn");
})();
