// A chart of curves over time or frequency, several sets of gains over each other.

import { axis, colour, digits } from "./chart.js";

const EARLY = 0.012;  // share of the picture in which a derivative's kick lies
const TALLER = 3;  // what stands out by more than this is clipped, and marked

function ends(values, from = 0) {
  let low = Infinity, high = -Infinity;
  for (let i = from; i < values.length; i++) {
    const value = values[i];
    if (value === null) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return low <= high ? [low, high] : null;
}

// What of the curves is worth its place: of a kick, and of what grows, only the beginning.
function frame(curves, floor) {
  const calm = curves.filter((curve) => curve.calm), seen = calm.length ? calm : curves;
  let low = Infinity, high = -Infinity;
  for (const { values } of seen) {
    const late = ends(values, Math.ceil(values.length * EARLY)), all = ends(values);
    if (!late) continue;
    const span = late[1] - late[0] || Math.abs(late[1]) || 1;
    low = Math.min(low, late[0], Math.max(all[0], late[0] - TALLER * span));
    high = Math.max(high, late[1], Math.min(all[1], late[1] + TALLER * span));
  }
  if (calm.length) {
    const span = high - low || 1;
    for (const { values } of curves.filter((curve) => !curve.calm)) {
      const all = ends(values);
      if (all) [low, high] = [Math.max(Math.min(low, all[0]), low - span), Math.min(Math.max(high, all[1]), high + span)];
    }
  }
  if (low > high) return [0, 1];
  low = Math.max(low, Math.min(floor, high - 90));
  const size = Math.max(Math.abs(low), Math.abs(high));
  const room = Math.max((high - low) * 0.08, size * 1e-6) || 1;  // no rounding noise over the whole height
  return [low - room, high + room];
}

// A triangle at the border above or below where a curve leaves the picture, with how far it goes.
function markClipped(plot, curves) {
  const { ctx, bbox, scales } = plot, size = 5 * devicePixelRatio;
  ctx.save();
  ctx.font = `${11 * devicePixelRatio}px ${getComputedStyle(document.body).fontFamily}`;
  let row = 0;
  for (const { values, stroke, peak } of curves) {
    const reach = ends(values);
    if (!reach) continue;
    const high = peak > reach[1] ? [0, peak] : [values.indexOf(reach[1]), reach[1]];
    for (const [up, [at, value]] of [[true, high], [false, [values.indexOf(reach[0]), reach[0]]]]) {
      if (up ? value <= scales.y.max : value >= scales.y.min) continue;
      const share = at / (values.length - 1);
      const x = bbox.left + Math.min(Math.max(share * bbox.width, size), bbox.width - size);
      const y = up ? bbox.top : bbox.top + bbox.height, way = up ? 1 : -1;
      ctx.fillStyle = stroke;
      ctx.beginPath();
      ctx.moveTo(x, y + way);
      ctx.lineTo(x - size, y + way * 1.7 * size);
      ctx.lineTo(x + size, y + way * 1.7 * size);
      ctx.fill();
      ctx.textAlign = share > 0.5 ? "right" : "left";
      const side = share > 0.5 ? -1 : 1;
      ctx.fillText(`peak ${Number(value.toPrecision(3))}`, x + side * 1.6 * size, y + way * (1.6 * size + 13 * devicePixelRatio * row) + (up ? size : 0));
      row++;
    }
  }
  ctx.restore();
}

// Whole powers of ten, not so many that they touch.
function decades(plot, _, low, high) {
  const first = Math.ceil(Math.log10(low)), last = Math.floor(Math.log10(high));
  const step = Math.ceil((last - first + 1) / 6) || 1;
  return Array.from({ length: Math.max(0, Math.floor((last - first) / step) + 1) }, (__, i) => 10 ** (first + i * step));
}

function guides(plot, levels) {
  const { ctx, bbox, scales } = plot;
  ctx.save();
  ctx.strokeStyle = colour("--quiet");
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
  for (const level of levels) {
    if (level < scales.y.min || level > scales.y.max) continue;
    const y = Math.round(plot.valToPos(level, "y", true));
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.restore();
}

// A curve is { label, stroke, dash, values, calm, peak }: `calm` unless it grows, `peak` what it reached between two points.
// `levels` are guides across the chart, below `floor` nothing is worth its place, `unit` stands behind numbers of the x axis, charts of one `key` share a cursor.
export function curveChart(figure, { title, unit, log = false, height = 190, levels = [], floor = -Infinity, key }) {
  figure.innerHTML = `<figcaption><b>${title}</b><span class="readout" aria-hidden="true"></span></figcaption><div class="curve" role="img"></div>`;
  const place = figure.querySelector(".curve"), readout = figure.querySelector(".readout");
  place.setAttribute("aria-label", title);
  let chart = null, kind = "", shown = { x: [], curves: [] };

  function read(plot) {
    const at = plot.cursor.idx;
    if (at === null || at === undefined || plot.cursor.left < 0) {
      readout.textContent = "";
      return;
    }
    const parts = shown.curves.map(({ label, values }) => `${label} ${digits(values[at])}`);
    readout.textContent = `${digits(shown.x[at])} ${unit} · ${parts.join(" · ")}`;
  }

  function build() {
    chart?.destroy();
    const { x, curves } = shown;
    chart = new uPlot({
      width: place.clientWidth || 300, height, padding: [6, 10, 0, 0], pxAlign: 0, legend: { show: false },
      cursor: { sync: { key }, drag: { x: true, y: false, setScale: true }, points: { size: 6 } },
      scales: { x: { time: false, distr: log ? 3 : 1, range: (_, low, high) => [low, high] }, y: { range: () => frame(shown.curves, floor) } },
      axes: [
        axis({
          size: 30, space: 60, values: (_, ticks) => ticks.map(digits), ...(log ? { splits: decades } : {}),
        }),
        axis({ size: 50, space: 28, values: (_, ticks) => ticks.map(digits) }),
      ],
      series: [{}, ...curves.map(({ label, stroke, dash, width }) => ({
        label, stroke, dash, width: width ?? 2, pxAlign: 0, points: { show: false },
      }))],
      hooks: {
        drawClear: [(plot) => guides(plot, levels)],
        draw: [(plot) => floor === -Infinity && markClipped(plot, shown.curves)],
        setCursor: [read],
      },
    }, [x, ...curves.map(({ values }) => values)], place);
  }

  function draw(x, curves) {
    const now = curves.map(({ label, stroke }) => label + stroke).join();
    const moved = x.length !== shown.x.length || x.at(-1) !== shown.x.at(-1) || x[0] !== shown.x[0];
    shown = { x, curves };
    if (chart === null || now !== kind || moved) {
      kind = now;
      build();
    } else {
      chart.batch(() => {
        const { min, max } = chart.scales.x;
        chart.setData([x, ...curves.map(({ values }) => values)], false);
        chart.setScale("x", { min, max });
      });
    }
    const told = curves.map(({ label, values }) => `${label} ends at ${digits(values.at(-1))}`).join(", ");
    place.setAttribute("aria-label", `${title}: ${told}`);
  }

  new ResizeObserver(() => {
    if (chart && place.clientWidth && place.clientWidth !== chart.width) chart.setSize({ width: place.clientWidth, height });
  }).observe(place);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => chart && build());
  return { draw };
}

