// The trade-off front of each structure: what a bound on max |S| costs. Points can be clicked, or reached by Tab.

import { digits, GREEN, RED, VIOLET } from "./page/chart.js";

const COLOURS = { pi: GREEN, pid: RED, fopid: VIOLET }, LABELS = { pi: "PI", pid: "PID", fopid: "FOPID" };
const WIDTH = 380, HEIGHT = 250, LEFT = 44, RIGHT = 56, TOP = 12, BOTTOM = 40;
const SVG = "http://www.w3.org/2000/svg";

function make(tag, fields, text = "") {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.textContent = text;
  return element;
}

export function startFront(root, take) {
  function draw(fronts) {
    const all = Object.values(fronts).flat();
    if (all.length === 0) {
      root.replaceChildren();
      return;
    }
    const costs = all.map(({ cost }) => Math.log(cost)), [low, high] = [Math.min(...costs), Math.max(...costs)];
    const mss = all.map(({ ms_max }) => ms_max), [left, right] = [Math.min(...mss), Math.max(...mss)];
    const x = (ms) => LEFT + ((ms - left) / (right - left || 1)) * (WIDTH - LEFT - RIGHT);
    const y = (cost) => TOP + 8 + ((high - Math.log(cost)) / (high - low || 1)) * (HEIGHT - TOP - BOTTOM - 16);
    const svg = make("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "group", "aria-label": "Cost over max S" });
    for (const ms of [...new Set(mss)].filter((_, i, { length }) => length < 6 || i % 2 === 0)) {
      svg.append(make("line", { class: "axis", x1: x(ms), x2: x(ms), y1: TOP, y2: HEIGHT - BOTTOM }));
      svg.append(make("text", { x: x(ms), y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, digits(ms)));
    }
    for (const level of [low, (low + high) / 2, high]) {
      const cost = Math.exp(level);
      svg.append(make("line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: y(cost), y2: y(cost) }));
      svg.append(make("text", { x: LEFT - 6, y: y(cost) + 4, "text-anchor": "end" }, Number(cost.toPrecision(2)).toString()));
    }
    svg.append(make("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, "robust ← max |S| → aggressive"));
    svg.append(make("text", { x: 10, y: HEIGHT / 2 - 10, "text-anchor": "middle", transform: `rotate(-90 10 ${HEIGHT / 2 - 10})` }, "IAE, both steps"));
    let taken = -Infinity;
    for (const [name, points] of Object.entries(fronts)) {
      if (points.length === 0) continue;
      const line = points.map(({ ms_max, cost }, i) => `${i ? "L" : "M"}${x(ms_max)} ${y(cost)}`).join("");
      svg.append(make("path", { d: line, stroke: COLOURS[name] }));
      const end = points.at(-1);
      taken = Math.max(y(end.cost), taken + 14);
      svg.append(make("text", { x: x(end.ms_max) + 9, y: taken + 4, fill: COLOURS[name] }, LABELS[name]));
      for (const point of points) svg.append(dot(point, x(point.ms_max), y(point.cost)));
    }
    root.replaceChildren(svg);
  }

  function dot(point, cx, cy) {
    const { structure, ms, cost, control_peak } = point;
    const told = `${LABELS[structure]}: Ms ${digits(Number(ms.toPrecision(3)))}, IAE ${digits(Number(cost.toPrecision(3)))}, control peak ${digits(Number(control_peak.toPrecision(3)))}`;
    const circle = make("circle", { cx, cy, r: 6, fill: COLOURS[structure], tabindex: 0, role: "button", "aria-label": `Take ${told}` });
    circle.append(make("title", {}, told));
    const choose = () => {
      root.querySelectorAll(".taken").forEach((other) => other.classList.remove("taken"));
      circle.classList.add("taken");
      take(point);
    };
    circle.addEventListener("click", choose);
    circle.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      choose();
    });
    return circle;
  }

  return { draw };
}
