// The three plots and the rows they draw. A row is [time, setpoint, measurement, control, P, I, D].

import { axis, BLUE, digits, GREEN, GREY, range, RED, VIOLET } from "./chart.js";

const COLUMNS = 7;
const LONGEST = 300;  // [s] kept
const MOST_ROWS = 60000;
const HEIGHT = 210;

const PLOTS = [
  { place: "plot-loop", series: [[1, "setpoint", GREY], [2, "measurement", BLUE]] },
  { place: "plot-control", series: [[3, "control", GREEN]] },
  { place: "plot-parts", series: [[4, "proportional", BLUE], [5, "integral", GREEN], [6, "derivative", VIOLET]] },
];

const rows = Array.from({ length: COLUMNS }, () => []);
let plots = [], marks = [], seconds = 30, paused = false, waiting = false;

function drawMarks(plot) {
  const { ctx, bbox, scales } = plot;
  ctx.save();
  ctx.strokeStyle = RED;
  ctx.lineWidth = devicePixelRatio;
  ctx.beginPath();
  for (const time of marks) {
    if (time < scales.x.min || time > scales.x.max) continue;
    const x = Math.round(plot.valToPos(time, "x", true));
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
  }
  ctx.stroke();
  ctx.restore();
}

function make({ place, series }, last) {
  const element = document.getElementById(place);
  const options = {
    width: element.clientWidth, height: HEIGHT, padding: [8, 12, 0, 0], pxAlign: 0,
    cursor: { sync: { key: "loop" }, drag: { x: false, y: false } },
    scales: { x: { time: false }, y: { range } },
    axes: [
      axis({ values: (_, ticks) => ticks.map((tick) => `${digits(tick)} s`), space: 70, size: 34 }),
      axis({ size: 62, values: (_, ticks) => ticks.map(digits) }),
    ],
    series: [
      { label: "time", value: (_, time) => (time === null ? "–" : `${time.toFixed(2)} s`) },
      ...series.map(([, label, stroke]) => ({
        label, stroke, width: 1.6, pxAlign: 0, points: { show: false }, value: (_, value) => digits(value),
      })),
    ],
    hooks: { draw: [drawMarks] },
  };
  element.replaceChildren();
  return { element, columns: [0, ...series.map(([column]) => column)], chart: new uPlot(options, last, element) };
}

function dataOf(columns) {
  return columns.map((column) => rows[column]);
}

export function build() {
  for (const { chart } of plots) chart.destroy();
  plots = PLOTS.map((plot) => make(plot, dataOf([0, ...plot.series.map(([column]) => column)])));
  draw();
}

function draw() {
  waiting = false;
  const from = Math.max(rows[0][0] ?? 0, (rows[0].at(-1) ?? 0) - seconds);
  for (const { chart, columns } of plots) {
    chart.batch(() => {
      chart.setData(dataOf(columns), false);
      chart.setScale("x", { min: from, max: from + seconds });
    });
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
  if (gone > rows[0].length / 4) {
    for (const column of rows) column.splice(0, gone);
  }
}

// Take new rows; `fresh` begins a new record.
export function append(news, fresh) {
  if (fresh) for (const column of rows) column.length = 0;
  for (const row of news) row.forEach((value, column) => rows[column].push(value));
  forget();
  drawSoon();
}

export function latest() {
  return rows.map((column) => column.at(-1) ?? null);
}

export function setMarks(times) {
  marks = times;
  drawSoon();
}

export function setWindow(length) {
  seconds = length;
  draw();
}

export function setPaused(value) {
  paused = value;
  drawSoon();
}

export function start() {
  build();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  new ResizeObserver(() => {
    for (const { chart, element } of plots) chart.setSize({ width: element.clientWidth, height: HEIGHT });
  }).observe(document.getElementById("plot-loop"));
}
