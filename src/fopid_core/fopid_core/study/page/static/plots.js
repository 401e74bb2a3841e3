// The plots of signals over time and the rows they draw. A row is [time, setpoint, measurement, control, P, I, D].

import { axis, BLUE, colour, digits, GREEN, GREY, RED, VIOLET } from "./chart.js";
import { navigate } from "./navigate.js";
import { extremes, label, roomy, spikeFree, ticks } from "./scales.js";

const COLUMNS = 7;
const LONGEST = 300;  // [s] kept
const MOST_ROWS = 60000;
const HEIGHT = 210;
const SHORTEST_RECORD = 2;  // [s]
const SHORTEST = 0.05;  // [s] that can be zoomed to
export const NAMES = ["time", "setpoint", "measurement", "control", "proportional", "integral", "derivative"];

const PLOTS = [
  { place: "plot-loop", unit: "measurement", series: [[1, GREY], [2, BLUE]] },
  { place: "plot-control", unit: "control", clips: true, series: [[3, GREEN]] },
  { place: "plot-parts", unit: "control", clips: true, series: [[4, BLUE], [5, GREEN], [6, VIOLET]] },
];

const rows = Array.from({ length: COLUMNS }, () => []);
const greatest = new Array(COLUMNS).fill(0);
const hidden = new Set();
let plots = [], marks = [], phases = [], units = {}, seconds = 30, paused = false, waiting = false;
let view = null;  // [from, to] when a person looks at a stretch; null follows the newest
let recordFrom = null;  // what is followed from its beginning, and not by the chosen length
let cursor = null, whenViewed = () => {}, known = () => true;

function withUnit(value, unit) {
  return value === null || value === undefined || !unit ? digits(value) : `${digits(value)} ${unit}`;
}

function drawMarks({ chart, phaseNames }) {
  const { ctx, bbox } = chart, pixel = devicePixelRatio;
  const at = (time) => Math.round(chart.valToPos(time, "x", true));
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  phases.forEach(({ name, from, to }, index) => {
    const left = at(from), right = at(to ?? rows[0].at(-1) ?? from);
    ctx.globalAlpha = index % 2 ? 0.07 : 0.14;
    ctx.fillStyle = BLUE;
    ctx.fillRect(left, bbox.top, right - left, bbox.height);
    ctx.globalAlpha = 1;
    ctx.fillStyle = colour("--quiet");
    ctx.font = `${11 * pixel}px sans-serif`;
    if (phaseNames && right - Math.max(left, bbox.left) > ctx.measureText(name).width + 8 * pixel) {
      ctx.fillText(name, Math.max(left, bbox.left) + 4 * pixel, bbox.top + 12 * pixel);
    }
  });
  ctx.strokeStyle = RED;
  ctx.lineWidth = pixel;
  ctx.beginPath();
  for (const time of marks) {
    ctx.moveTo(at(time), bbox.top);
    ctx.lineTo(at(time), bbox.top + bbox.height);
  }
  ctx.stroke();
  ctx.restore();
}

// A triangle at the edge where a curve goes beyond it, and how far the furthest goes.
function drawClipped(plot) {
  const { chart, clipped } = plot, { ctx, bbox } = chart, size = 5 * devicePixelRatio;
  ctx.save();
  ctx.fillStyle = RED;
  ctx.font = `${11 * devicePixelRatio}px sans-serif`;
  for (const { time, value, up, furthest } of clipped) {
    const x = chart.valToPos(time, "x", true), y = up ? bbox.top : bbox.top + bbox.height, inward = up ? size : -size;
    ctx.beginPath();
    ctx.moveTo(x, y);
    ctx.lineTo(x - size, y + 1.6 * inward);
    ctx.lineTo(x + size, y + 1.6 * inward);
    ctx.fill();
    if (!furthest) continue;
    const text = digits(value), width = ctx.measureText(text).width;
    const beside = x + 2 * size + width > bbox.left + bbox.width ? x - 2 * size - width : x + 2 * size;
    ctx.fillText(text, beside, y + (up ? 2.2 * size : -0.6 * size));
  }
  ctx.restore();
}

function makeLegend(plot) {
  const list = document.createElement("ul");
  list.className = "legend";
  for (const [column, stroke] of plot.series) {
    const item = document.createElement("li"), button = document.createElement("button");
    button.type = "button";
    button.id = `show-${NAMES[column]}`;
    button.title = `show or hide ${NAMES[column]}`;
    button.setAttribute("aria-pressed", String(!hidden.has(column)));
    button.innerHTML = `<svg width="14" height="4" aria-hidden="true"><rect width="14" height="3" fill="${stroke}"/></svg>
      ${NAMES[column]} <b></b>`;
    button.addEventListener("click", () => {
      if (!hidden.delete(column)) hidden.add(column);
      button.setAttribute("aria-pressed", String(!hidden.has(column)));
      draw();
    });
    plot.values.set(column, button.querySelector("b"));
    item.append(button);
    list.append(item);
  }
  const when = document.createElement("li");
  when.className = "quiet when";
  plot.when = when;
  list.append(when);
  return list;
}

function make({ place, unit, clips, series }) {
  const element = document.getElementById(place);
  const plot = { element, unit, clips, series, values: new Map(), clipped: [], range: [0, 1], first: 0, phaseNames: false };
  plot.phaseNames = place === "plot-loop";
  const places = () => ticks(plot.range, 5);
  const options = {
    width: element.clientWidth, height: HEIGHT, padding: [8, 12, 0, 0], pxAlign: 0,
    cursor: { sync: { key: "loop" }, drag: { x: true, y: false, setScale: false }, points: { size: 7 } },
    legend: { show: false },
    // The curves are scaled before, so that any magnitude can be drawn.
    scales: { x: { time: false, auto: false }, y: { auto: false, range: [0, 1] } },
    axes: [
      axis({ values: (_, found) => found.map((tick) => `${digits(tick)} s`), space: 70, size: 34 }),
      axis({
        size: 70,
        splits: () => places().found.map((tick) => (tick - plot.range[0]) / (plot.range[1] - plot.range[0])),
        values: () => places().found.map((tick) => label(tick, places().step)),
      }),
    ],
    series: [{}, ...series.map(([, stroke]) => ({ stroke, width: 1.6, pxAlign: 0, points: { show: false } }))],
    hooks: {
      drawClear: [() => drawMarks(plot)], draw: [() => drawClipped(plot)],
      setCursor: [({ cursor: { idx, left } }) => {
        cursor = idx === null || idx === undefined || left < 0 ? null : { index: idx + plot.first };
        showValues();
      }],
      setSelect: [(chart) => {
        if (chart.select.width < 4) return;
        const [from, to] = [chart.select.left, chart.select.left + chart.select.width].map((x) => chart.posToVal(x, "x"));
        chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        look([from, to]);
      }],
    },
  };
  element.replaceChildren();
  plot.chart = new uPlot(options, [[0], ...series.map(() => [null])], element);
  plot.note = Object.assign(document.createElement("p"), { className: "quiet clipped", hidden: true });
  for (const old of element.parentElement.querySelectorAll(".legend, .clipped")) old.remove();
  element.after(makeLegend(plot), plot.note);
  navigate(plot.chart, { zoom, shift, live: () => look(null) }, place === "plot-loop");
  return plot;
}

// The first row at or after a time.
function rowAt(time) {
  let low = 0, high = rows[0].length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[0][middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

export function shownStretch() {
  if (view) return view;
  if (recordFrom !== null) return [recordFrom, Math.max(rows[0].at(-1) ?? 0, recordFrom + SHORTEST_RECORD)];
  const from = Math.max(rows[0][0] ?? 0, (rows[0].at(-1) ?? 0) - seconds);
  return [from, from + seconds];
}

function rangeOf(plot, columns, first, last) {
  const whole = extremes(columns, first, last);
  plot.clipped = [];
  if (whole === null) return [0, 1];
  const free = plot.clips ? spikeFree(rows[0], columns, first, last) : null;
  const size = Math.max(...plot.series.map(([column]) => greatest[column]));
  if (free === null) return roomy(whole, size);
  const range = roomy(free, size);
  findClipped(plot, columns, first, last, range);
  return range;
}

// One mark for each stretch beyond the range, at its furthest.
function findClipped(plot, columns, first, last, [low, high]) {
  for (const column of columns) {
    let mark = null;
    for (let i = first; i < last; i++) {
      const value = column[i], up = value > high;
      if (value === null || (!up && value >= low)) {
        mark = null;
      } else if (mark === null || mark.up !== up) {
        mark = { time: rows[0][i], value, up };
        plot.clipped.push(mark);
      } else if (Math.abs(value) > Math.abs(mark.value)) {
        Object.assign(mark, { time: rows[0][i], value });
      }
    }
  }
  for (const up of [true, false]) {
    const side = plot.clipped.filter((mark) => mark.up === up);
    const furthest = side.reduce((one, other) => (Math.abs(other.value) > Math.abs(one.value) ? other : one), side[0]);
    if (furthest) furthest.furthest = true;
  }
}

function scaled(column, first, last, [low, high]) {
  const span = high - low, values = new Array(last - first);
  for (let i = first; i < last; i++) {
    const value = column[i];
    values[i - first] = value === null ? null : Math.min(Math.max((value - low) / span, -0.05), 1.05);
  }
  return values;
}

function drawPlot(plot, from, to, first, last) {
  const shown = plot.series.map(([column]) => column).filter((column) => !hidden.has(column));
  plot.range = rangeOf(plot, shown.map((column) => rows[column]), Math.min(rowAt(from), last), last);
  plot.first = first;
  const data = plot.series.map(([column]) => (
    hidden.has(column) ? new Array(last - first).fill(null) : scaled(rows[column], first, last, plot.range)
  ));
  plot.chart.batch(() => {
    plot.chart.setData([rows[0].slice(first, last), ...data], false);
    plot.chart.setScale("x", { min: from, max: to });
    plot.chart.setScale("y", { min: 0, max: 1 });
  });
  const peaks = plot.clipped.filter((mark) => mark.furthest);
  plot.note.hidden = peaks.length === 0;
  const told = peaks.map(({ time, value }) => `${digits(value)} at ${time.toFixed(2)} s`).join(", ");
  if (peaks.length) plot.note.textContent = `Peaks beyond the scale: ${told}`;
}

function draw() {
  waiting = false;
  const [from, to] = shownStretch();
  const first = Math.max(rowAt(from) - 1, 0), last = Math.min(rowAt(to) + 1, rows[0].length);
  for (const plot of plots) drawPlot(plot, from, to, first, last);
  showValues();
}

// The values under the cursor, or the newest.
function showValues() {
  const index = cursor && cursor.index < rows[0].length ? cursor.index : rows[0].length - 1;
  for (const plot of plots) {
    for (const [column, place] of plot.values) {
      const value = cursor || known(NAMES[column]) ? rows[column][index] : null;
      const text = withUnit(value, units[plot.unit]);
      if (place.textContent !== text) place.textContent = text;
    }
    const when = cursor && rows[0][index] !== undefined ? `at ${rows[0][index].toFixed(2)} s` : "";
    if (plot.when.textContent !== when) plot.when.textContent = when;
  }
}

function drawSoon() {
  if (waiting || paused) return;
  waiting = true;
  requestAnimationFrame(draw);
}

function forget() {
  const oldest = rows[0].at(-1) - LONGEST;
  let gone = Math.max(0, rows[0].length - MOST_ROWS);
  while (rows[0][gone] < oldest) gone++;
  if (gone > rows[0].length / 4 && (!view || rows[0].length > 2 * MOST_ROWS)) {  // what is looked at stays for a while
    for (const column of rows) column.splice(0, gone);
    cursor = null;
  }
}

// Look at a stretch of time; null follows the newest again.
function look(stretch) {
  if (stretch) {
    const [from, to] = stretch, middle = (from + to) / 2, half = Math.max(to - from, SHORTEST) / 2;
    view = [middle - half, middle + half];
  } else {
    view = paused ? view : null;
  }
  draw();
  whenViewed({ live: view === null });
}

// A factor below 1 shows less time, around an instant (the newest end by default).
export function zoom(factor, around = null) {
  const [from, to] = shownStretch(), end = view ? (from + to) / 2 : Math.min(to, rows[0].at(-1) ?? to), centre = around ?? end;
  look([centre - (centre - from) * factor, centre + (to - centre) * factor]);
}

// By a share of what is shown.
export function shift(share) {
  const [from, to] = shownStretch(), by = share * (to - from);
  look([from + by, to + by]);
}

export function live() {
  look(null);
}

// Take new rows; `fresh` begins a new record.
export function append(news, fresh) {
  if (fresh) {
    for (const column of rows) column.length = 0;
    greatest.fill(0);
    cursor = recordFrom = null;
    view = paused ? view : null;
  }
  for (const row of news) {
    row.forEach((value, column) => {
      rows[column].push(value);
      if (column && value !== null && Math.abs(value) > greatest[column]) greatest[column] = Math.abs(value);
    });
  }
  forget();
  drawSoon();
}

export function latest() {
  return rows.map((column) => column.at(-1) ?? null);
}

// Times at which the gains changed.
export function setMarks(times) {
  marks = times;
  drawSoon();
}

// Stretches that are tinted: { name, from, to }, `to` null for one that goes on: then all is shown from the first on.
export function setPhases(stretches) {
  const goesOn = stretches.some(({ to }) => to === null), went = phases.some(({ to }) => to === null);
  if (goesOn !== went) recordFrom = goesOn ? stretches[0].from : null;
  phases = stretches;
  drawSoon();
}

export function setUnits(named) {
  units = named;
}

// Says of a signal's name whether its newest value is the present one.
export function setKnown(tell) {
  known = tell;
}

export function setWindow(length) {
  seconds = length;
  recordFrom = null;
  look(null);
}

export function setPaused(value) {
  view = value ? shownStretch() : null;
  paused = value;
  if (!value) draw();
  whenViewed({ live: view === null });
}

// What is shown, as [names, columns], for a file.
export function shownData() {
  const [from, to] = shownStretch(), first = rowAt(from), last = rowAt(to + 1e-9);
  const named = NAMES.map((name, column) => {
    const unit = column === 0 ? "s" : units[column < 3 ? "measurement" : "control"];
    return unit ? `${name} [${unit}]` : name;
  });
  return { names: named, columns: rows.map((column) => column.slice(first, last)) };
}

// The numbers along the y axis of a plot.
export function axisLabels(place) {
  const plot = plots.find(({ element }) => element.id === place), { found, step } = ticks(plot.range, 5);
  return found.map((tick) => label(tick, step));
}

export function canvases() {
  return plots.map(({ chart, series, values }) => ({
    canvas: chart.ctx.canvas,
    legend: series.map(([column, stroke]) => ({ stroke, text: `${NAMES[column]} ${values.get(column).textContent}` })),
  }));
}

export function build() {
  for (const { chart } of plots) chart.destroy();
  plots = PLOTS.filter(({ place }) => document.getElementById(place)).map(make);
  draw();
}

export function start(onView = () => {}) {
  whenViewed = onView;
  build();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  new ResizeObserver(() => {
    for (const { chart, element } of plots) if (element.clientWidth) chart.setSize({ width: element.clientWidth, height: HEIGHT });
  }).observe(document.getElementById("plot-loop"));
}
