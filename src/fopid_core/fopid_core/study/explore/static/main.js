// The page without ROS: one process, a baseline, new gains, and everything that follows from them.

import { ask, rememberToken } from "./page/ask.js";
import { createPrediction } from "./page/prediction.js";
import { createSliders } from "./page/sliders.js";
import { startComparison } from "./comparison.js";
import { startFront } from "./front.js";
import { startLearning } from "./learning.js";
import { startTaking } from "./taking.js";
import { startWishes } from "./wishes.js";

const at = (id) => document.getElementById(id);
const page = { process: null, about: null, baseline: null, gains: null, horizon: null, others: [] };

const prediction = createPrediction(at("prediction"), (fields) => ask("predict", fields));
const sliders = createSliders(at("sliders"), (gains) => take(gains, { begun: performance.now() }));
const front = startFront(at("front"), (design) => take(design.gains, { sliders: true, name: design.structure.toUpperCase() }));
const wishes = startWishes({ ask, take, front, state: page });
const comparison = startComparison({ ask, take, state: page });
const taking = startTaking({ ask, state: page });
startLearning({ ask, use: useProcess });

function show(begun) {
  if (!page.about) return;
  const sets = [{ label: "baseline", kind: "baseline", gains: page.baseline }, ...page.others,
    { label: page.name ? `new, ${page.name}` : "new", kind: "new", gains: page.gains }];
  prediction.show({ process: page.process, sets, horizon: page.horizon, begun });
}

// New gains, from wherever: the sliders show them and the picture follows; `others` are drawn beside them.
function take(gains, { begun, sliders: moved, others = [], name = "" } = {}) {
  page.gains = gains;
  page.name = name;
  page.others = others;
  if (moved) sliders.set(gains);
  show(begun);
  taking.show();
}

function showError({ message, text, position, reason }) {
  const pointed = position !== undefined && text !== undefined;
  at("process-error").hidden = false;
  at("process-error").textContent = pointed ? `${text}\n${" ".repeat(position)}^ ${reason}` : message;
  at("process").setAttribute("aria-invalid", "true");
  if (pointed) at("process").setSelectionRange(position, position + 1);
}

// The transfer function with its exponents raised.
function showFormula({ process, nature }) {
  const parts = `P(s) = ${process}`.split(/\^(\d+(?:\.\d+)?|\([^)]*\))/);
  at("process-note").querySelector(".math").replaceChildren(...parts.map((part, i) => (
    i % 2 ? Object.assign(document.createElement("sup"), { textContent: part }) : part)));
  at("process-note").querySelector(".nature").textContent = `· ${nature}`;
}

// Begin with a process: its ranges, a first design, a time that shows it.
async function useProcess(text) {
  const about = await ask("process", { process: text });
  if (about.status === 401) {
    at("access").textContent = about.message;
    return false;
  }
  if (about.status !== 200) {
    showError(about);
    return false;
  }
  at("process-error").hidden = true;
  at("process").removeAttribute("aria-invalid");
  at("process").value = text;
  if (about.first.reason) at("process-note").title = about.first.reason;
  const first = about.first.gains ?? { kp: 0, ki: 0, kd: 0, lam: 1, mu: 1 };
  Object.assign(page, { process: text, about, baseline: first, gains: first, horizon: null, others: [] });
  for (const button of document.querySelectorAll("[data-process]")) {
    button.setAttribute("aria-pressed", String(button.dataset.process === text));
  }
  showFormula(about);
  const answer = await ask("predict", { process: text, sets: [first] });
  page.horizon = answer.status === 200 ? answer.horizon : null;
  at("span").value = page.horizon ?? "";
  sliders.set(first);
  sliders.setRanges(about.ranges, about.sign);
  comparison.forget();
  take(first);
  wishes.begin();
  return true;
}

async function begin() {
  rememberToken();
  const start = await ask("start");
  if (start.status !== 200) {
    at("access").textContent = start.message;
    return;
  }
  at("access").textContent = "";
  await useProcess(start.process);
  if (start.learnt) startLearning.show(start.learnt, { taken: true });
}

at("process-form").addEventListener("submit", (event) => {
  event.preventDefault();
  useProcess(at("process").value.trim());
});
for (const button of document.querySelectorAll("[data-process]")) {
  button.addEventListener("click", () => useProcess(button.dataset.process));
}
at("keep").addEventListener("click", () => {
  page.baseline = page.gains;
  show();
});
at("back").addEventListener("click", () => take(page.baseline, { sliders: true }));
at("span").addEventListener("input", () => {
  const seconds = at("span").valueAsNumber;
  at("span").setAttribute("aria-invalid", String(!(seconds > 0)));
  if (!(seconds > 0)) return;
  page.horizon = seconds;
  show();
});
addEventListener("hashchange", begin);
begin();
