// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// Arrays from text, places in them, numbers as text.

/** Little-endian float32 numbers that are written in base 64. */
function floats(text) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

/** Index of the first entry of sorted `times` that is not below `time`. */
function lowerBound(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Index of the entry of sorted `times` that is nearest to `time`; -1 of none. */
function nearest(times, time) {
  const above = lowerBound(times, time);
  if (above === 0) return times.length ? 0 : -1;
  if (above === times.length) return above - 1;
  return time - times[above - 1] <= times[above] - time ? above - 1 : above;
}

/**
 * Index of the entry that stands for `time`: -1 outside of the times and where a line is broken.
 * `breaks`: sorted indices before which it is.
 */
function entryAt(times, breaks, time) {
  const index = nearest(times, time);
  if (index < 0) return -1;
  const last = times.length - 1;
  const slack = last > 0 ? (times[last] - times[0]) / last : 1;
  if (time < times[0] - slack || time > times[last] + slack) return -1;
  const above = lowerBound(times, time);
  const between = above > 0 && above <= last && breaks.includes(above);
  return between && Math.abs(times[index] - time) > slack ? -1 : index;
}

/** Round numbers from `low` to `high`, about `count` of them. */
function ticks(low, high, count) {
  const span = high - low;
  if (!(span > 0) || !Number.isFinite(span)) return [];
  const rough = span / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * span; k += 1) found.push(k * step);
  return found;
}

/** Values for a logarithmic axis: 1, 2, 5, 10, ... where that is no more than `count`, or fewer. */
function logTicks(low, high, count) {
  const first = Math.floor(Math.log10(low));
  const last = Math.ceil(Math.log10(high));
  for (const digits of [[1, 2, 5], [1]]) {
    const found = [];
    for (let power = first; power <= last; power += 1) {
      found.push(...digits.map((digit) => digit * 10 ** power));
    }
    const seen = found.filter((value) => value >= low && value <= high);
    if (seen.length <= count) return seen;
    if (digits.length === 1) {
      return seen.filter((_, k) => k % Math.ceil(seen.length / count) === 0);
    }
  }
  return [];
}

/** A number as the end of an axis shows it: -12.3M, 0.004. */
function compact(value) {
  const size = Math.abs(value);
  for (const [unit, suffix] of [[1e12, "T"], [1e9, "G"], [1e6, "M"], [1e4, "k"]]) {
    if (size >= unit) {
      const scale = suffix === "k" ? 1e3 : unit;
      return `${trimmed((value / scale).toPrecision(4))}${suffix}`.replace("-", "−");
    }
  }
  if (size > 0 && size < 1e-4) return value.toExponential(0).replace("e-", "e−").replace("-", "−");
  return trimmed(value.toPrecision(6)).replace("-", "−");
}

function trimmed(text) {
  return text.includes(".") && !text.includes("e") ? text.replace(/\.?0+$/, "") : text;
}

/** A number to three digits, with its unit. */
function reading(value, unit) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  const digits = size >= 1e6 ? compact(value)
    : (size >= 1e3 ? Math.round(value).toLocaleString("en") : trimmed(value.toPrecision(3)))
      .replace("-", "−");
  return unit ? `${digits}${unit === "°" ? "" : " "}${unit}` : digits;
}

/** A moment with as many digits as a view of `span` seconds tells apart. */
function moment(time, span) {
  const digits = Math.min(Math.max(Math.ceil(-Math.log10(span / 2000)), 0), 4);
  return `${time.toFixed(digits)} s`;
}

function clamp(value, low, high) {
  return Math.min(Math.max(value, low), high);
}

function escaped(text) {
  return String(text)
    .replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;").replace(/"/g, "&quot;");
}
