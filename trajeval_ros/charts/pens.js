// Copyright 2026 The trajeval_ros authors
// SPDX-License-Identifier: Apache-2.0
// Two ways to draw the same figure: on a canvas for the screen, as SVG for paper.
//
// A colour is the name of a custom property without its dashes ("ink"), or a mix of two,
// ["low", "high", 0.3]. Lengths are CSS pixels; points are flat, [x0, y0, x1, y1, ...].

/** Colours as a canvas wants them, of the theme that holds now. */
class Theme {
  constructor() {
    this.known = new Map();
    this.style = getComputedStyle(document.documentElement);
    this.font = getComputedStyle(document.body).fontFamily;
  }

  colour(name) {
    if (Array.isArray(name)) {
      const [from, to, share] = name;
      const a = this.parts(from);
      const b = this.parts(to);
      return `rgb(${a.map((value, k) => Math.round(value + share * (b[k] - value))).join(" ")})`;
    }
    if (!this.known.has(name)) {
      this.known.set(name, this.style.getPropertyValue(`--${name}`).trim() || "#888888");
    }
    return this.known.get(name);
  }

  parts(name) {
    const hex = this.colour(name).slice(1);
    return [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16));
  }
}

class CanvasPen {
  constructor(context, theme) {
    this.context = context;
    this.theme = theme;
  }

  line(points, look) {
    this.lines([points], look);
  }

  /** Several lines of one look: far faster than one by one. */
  lines(all, { stroke, width = 1, dash = [], alpha = 1 }) {
    const { context } = this;
    context.save();
    context.beginPath();
    for (const points of all) this.trace(points);
    context.globalAlpha = alpha;
    context.strokeStyle = this.theme.colour(stroke);
    context.lineWidth = width;
    context.lineJoin = "round";
    context.lineCap = dash.length ? "butt" : "round";
    context.setLineDash(dash);
    context.stroke();
    context.restore();
  }

  area(points, { fill, alpha = 1, stroke = null, width = 1 }) {
    const { context } = this;
    context.save();
    context.beginPath();
    this.trace(points);
    context.closePath();
    context.globalAlpha = alpha;
    context.fillStyle = this.theme.colour(fill);
    context.fill();
    if (stroke) {
      context.strokeStyle = this.theme.colour(stroke);
      context.lineWidth = width;
      context.stroke();
    }
    context.restore();
  }

  circle(x, y, radius, { fill, stroke = null, width = 1 }) {
    const { context } = this;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = this.theme.colour(fill);
    context.fill();
    if (stroke) {
      context.strokeStyle = this.theme.colour(stroke);
      context.lineWidth = width;
      context.stroke();
    }
  }

  text(x, y, text, { fill = "muted", align = "left", size = 11, weight = 400, halo = null }) {
    const { context } = this;
    context.font = `${weight} ${size}px ${this.theme.font}`;
    context.textAlign = align;
    context.textBaseline = "middle";
    if (halo) {
      context.strokeStyle = this.theme.colour(halo);
      context.lineWidth = 4;
      context.lineJoin = "round";
      context.strokeText(text, x, y);
    }
    context.fillStyle = this.theme.colour(fill);
    context.fillText(text, x, y);
  }

  clipped(x, y, width, height, draw) {
    this.context.save();
    this.context.beginPath();
    this.context.rect(x, y, width, height);
    this.context.clip();
    draw();
    this.context.restore();
  }

  trace(points) {
    const { context } = this;
    for (let k = 0; k < points.length; k += 2) {
      if (k === 0) context.moveTo(points[0], points[1]);
      else context.lineTo(points[k], points[k + 1]);
    }
  }
}

let clips = 0;

class SvgPen {
  constructor() {
    this.parts = [];
  }

  static colour(name) {
    if (!Array.isArray(name)) return `var(--${name})`;
    const [from, to, share] = name;
    return `color-mix(in srgb, var(--${from}), var(--${to}) ${(100 * share).toFixed(0)}%)`;
  }

  line(points, look) {
    this.lines([points], look);
  }

  lines(all, { stroke, width = 1, dash = [], alpha = 1 }) {
    const dashed = dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : "";
    const faint = alpha < 1 ? ` opacity="${alpha}"` : "";
    this.parts.push(
      `<path d="${all.map((points) => `M${SvgPen.places(points)}`).join("")}" fill="none"`
      + ` stroke-width="${width}" stroke-linejoin="round"${dashed}${faint}`
      + ` style="stroke:${SvgPen.colour(stroke)}"/>`,
    );
  }

  area(points, { fill, alpha = 1, stroke = null, width = 1 }) {
    const edge = stroke ? `;stroke:${SvgPen.colour(stroke)}` : "";
    this.parts.push(
      `<polygon points="${SvgPen.places(points)}" stroke-width="${width}" opacity="${alpha}"`
      + ` style="fill:${SvgPen.colour(fill)}${edge}"/>`,
    );
  }

  circle(x, y, radius, { fill, stroke = null, width = 1 }) {
    const edge = stroke ? `;stroke:${SvgPen.colour(stroke)}` : "";
    this.parts.push(
      `<circle cx="${x.toFixed(1)}" cy="${y.toFixed(1)}" r="${radius}" stroke-width="${width}"`
      + ` style="fill:${SvgPen.colour(fill)}${edge}"/>`,
    );
  }

  text(x, y, text, { fill = "muted", align = "left", size = 11, weight = 400, halo = null }) {
    const anchor = { left: "start", center: "middle", right: "end" }[align];
    const edge = halo
      ? `;stroke:${SvgPen.colour(halo)};stroke-width:4px;paint-order:stroke;stroke-linejoin:round`
      : "";
    this.parts.push(
      `<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" dy="0.35em" text-anchor="${anchor}"`
      + ` font-size="${size}" font-weight="${weight}" style="fill:${SvgPen.colour(fill)}${edge}">`
      + `${escaped(text)}</text>`,
    );
  }

  clipped(x, y, width, height, draw) {
    clips += 1;
    const id = `clip${clips}`;
    this.parts.push(
      `<clipPath id="${id}"><rect x="${x}" y="${y}" width="${width}" height="${height}"/></clipPath>`
      + `<g clip-path="url(#${id})">`,
    );
    draw();
    this.parts.push("</g>");
  }

  /** The whole drawing; `label` is what a reader hears. */
  svg(width, height, label) {
    return `<svg viewBox="0 0 ${width} ${height}" role="img" aria-label="${escaped(label)}">`
      + `${this.parts.join("")}</svg>`;
  }

  static places(points) {
    const found = [];
    for (let k = 0; k < points.length; k += 2) {
      found.push(`${points[k].toFixed(1)},${points[k + 1].toFixed(1)}`);
    }
    return found.join(" ");
  }
}
