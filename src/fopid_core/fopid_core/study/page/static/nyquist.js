// L(jw) in the plane, with the point -1 and the circle that max |S| keeps free.

import { colour, digits, RED } from "./chart.js";

const LEFT = -2.4, RIGHT = 1.4, BOTTOM = -2.1, TOP = 1.1;

export function nyquistChart(figure, { title = "Nyquist", height = 190 } = {}) {
  figure.innerHTML = `<figcaption><b>${title}</b><span class="readout"></span></figcaption>
    <canvas class="curve" role="img"></canvas>`;
  const canvas = figure.querySelector("canvas"), readout = figure.querySelector(".readout");
  let shown = [];

  function draw(curves = shown) {
    shown = curves;
    const width = canvas.parentElement.clientWidth, ratio = devicePixelRatio;
    if (!width) return;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    if (canvas.width !== width * ratio) [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height);
    const scale = Math.min(width / (RIGHT - LEFT), height / (TOP - BOTTOM));
    const x0 = width / 2 - scale * (LEFT + RIGHT) / 2, y0 = scale * TOP;
    const X = (re) => x0 + scale * re, Y = (im) => y0 - scale * im;
    const circle = (re, radius, stroke, dash) => {
      ctx.beginPath();
      ctx.arc(X(re), Y(0), scale * radius, 0, 2 * Math.PI);
      ctx.strokeStyle = stroke;
      ctx.setLineDash(dash);
      ctx.stroke();
    };
    ctx.lineWidth = 1;
    ctx.strokeStyle = colour("--rule");
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.moveTo(0, Y(0)); ctx.lineTo(width, Y(0));
    ctx.moveTo(X(0), 0); ctx.lineTo(X(0), height);
    ctx.stroke();
    circle(0, 1, colour("--rule"), []);
    const newest = shown.at(-1);
    if (newest?.ms) circle(-1, 1 / newest.ms, newest.stroke, [2, 3]);
    for (const { re, im, stroke, dash } of shown) {
      ctx.strokeStyle = stroke;
      ctx.lineWidth = 2;
      ctx.setLineDash(dash ?? []);
      ctx.beginPath();
      let pen = false;
      for (let i = 0; i < re.length; i++) {
        if (re[i] === null || Math.abs(re[i]) > 50 || Math.abs(im[i]) > 50) {
          pen = false;
          continue;
        }
        ctx[pen ? "lineTo" : "moveTo"](X(re[i]), Y(im[i]));
        pen = true;
      }
      ctx.stroke();
    }
    ctx.setLineDash([]);
    ctx.fillStyle = RED;
    ctx.beginPath();
    ctx.arc(X(-1), Y(0), 3.5, 0, 2 * Math.PI);
    ctx.fill();
    ctx.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    ctx.textAlign = "center";
    ctx.fillText("−1", X(-1), Y(0) - 8);
    readout.textContent = newest?.ms ? `free circle about −1: 1/Ms = ${digits(Number((1 / newest.ms).toPrecision(3)))}` : "";
    canvas.setAttribute("aria-label", `${title}: ${shown.map(({ label, ms }) => `${label}, ${ms ? `Ms ${digits(ms)}` : "Ms not known"}`).join("; ")}`);
  }

  new ResizeObserver(() => draw()).observe(figure);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
  return { draw };
}
