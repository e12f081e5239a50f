// Copyright 2026 The dotsim_ros authors
// SPDX-License-Identifier: Apache-2.0

// Force over time: the last seconds while it is live, all of it and a mark where a bag is shown.

const COLOURS = [["Fx", "#ff6b6b"], ["Fy", "#51cf66"], ["Fz", "#4dabf7"]];
const LIVE_S = 20;
const KEPT = 4000;
const LEAST_N = 0.1;
const MARGIN = {left: 46, right: 12, top: 22, bottom: 20};

export class ForcePlot {
  constructor(canvas) {
    this.canvas = canvas;
    this.points = [];
    this.mark = null;
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Replace all forces; `mark` is the time in a bag, null while it is live.
  set(points, mark) {
    this.points = points;
    this.mark = mark;
  }

  add(time, force) {
    const last = this.points.at(-1);
    if (last && time === last[0]) return;
    // Time has begun again.
    if (last && time < last[0]) this.points.length = 0;
    this.points.push([time, ...force]);
    if (this.points.length > KEPT) this.points.splice(0, KEPT / 4);
  }

  draw() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    const all = this.points;
    const end = all.length ? all.at(-1)[0] : 0;
    const isBag = this.mark !== null;
    const start = isBag && all.length ? all[0][0] : end - LIVE_S;
    const shown = all.filter(point => point[0] >= start);
    const [low, high] = range(shown);
    const right = width - MARGIN.right, bottom = height - MARGIN.bottom;
    const span = Math.max(end - start, 1e-3);
    const x = time => MARGIN.left + (time - start) / span * (right - MARGIN.left);
    const y = force => bottom - (force - low) / (high - low) * (bottom - MARGIN.top);
    pen.strokeStyle = "#2b323d";
    pen.fillStyle = "#97a3b4";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const step = nice((high - low) / 4);
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) {
      line(pen, [[MARGIN.left, y(value)], [right, y(value)]]);
      pen.fillText(text(value, step), MARGIN.left - 6, y(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const seconds = nice(span / 6);
    // From the end while it is live, from the start in a bag.
    for (let ticks = 0; ticks * seconds <= span + 1e-9; ++ticks) {
      const time = isBag ? start + ticks * seconds : end - ticks * seconds;
      const label = isBag ? ticks * seconds : -ticks * seconds;
      const place = Math.min(Math.max(x(time), MARGIN.left + 8), right - 12);
      pen.fillText(`${text(label, seconds)} s`, place, bottom + 5);
    }
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, MARGIN.top - 2, right - MARGIN.left, bottom - MARGIN.top + 4);
    pen.clip();
    pen.lineWidth = 1.6;
    pen.lineJoin = "round";
    COLOURS.forEach(([, colour], index) => {
      pen.strokeStyle = colour;
      line(pen, shown.map(point => [x(point[0]), y(point[1 + index])]));
    });
    if (isBag) {
      pen.strokeStyle = "#e6e9ee";
      pen.lineWidth = 1;
      line(pen, [[x(this.mark), MARGIN.top], [x(this.mark), bottom]]);
    }
    pen.restore();
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillStyle = "#97a3b4";
    pen.fillText("Force on the indenter, N", MARGIN.left, 11);
    COLOURS.forEach(([name, colour], index) => {
      pen.fillStyle = colour;
      pen.fillText(name, MARGIN.left + 160 + 32 * index, 11);
    });
  }
}

function range(points) {
  let low = 0, high = LEAST_N;
  for (const point of points) {
    for (let index = 1; index < 4; ++index) {
      low = Math.min(low, point[index]);
      high = Math.max(high, point[index]);
    }
  }
  const room = 0.06 * (high - low);
  return [low < 0 ? low - room : 0, high + room];
}

function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return power * [1, 2, 5, 10].find(factor => factor * power >= step * 0.999);
}

function text(value, step) {
  return (Math.abs(value) < 1e-9 ? 0 : value).toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
}

function line(pen, places) {
  pen.beginPath();
  places.forEach(([x, y], index) => (index ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}
