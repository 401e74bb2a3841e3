// Learn the process from a record, and show how well the models fit what was held back.

import { BLUE, GREY } from "./page/chart.js";
import { curveChart } from "./page/curves.js";

const at = (id) => document.getElementById(id);
const LARGEST = 12e6;  // bytes

function cell(tag, textContent, more = {}) {
  return Object.assign(document.createElement(tag), { textContent, ...more });
}

async function base64(file) {
  const url = await new Promise((resolve, reject) => {
    const reader = Object.assign(new FileReader(), { onload: () => resolve(reader.result), onerror: () => reject(reader.error) });
    reader.readAsDataURL(file);
  });
  return url.slice(url.indexOf(",") + 1);
}

export function startLearning({ ask, use }) {
  let chart = null;

  function say(text, good) {
    at("learn-answer").textContent = text;
    at("learn-answer").className = `answer ${good ? "good" : "bad"}`;
  }

  async function show(learnt, { taken = false } = {}) {
    say(`${learnt.name}: ${learnt.message}`, learnt.success);
    at("learnt").hidden = learnt.models.length === 0;
    if (learnt.models.length === 0) return;
    chart ??= curveChart(at("fit"), { title: "Measurement and model", unit: "s", key: "fit", height: 220 });
    const { time, measurement, model } = learnt.picture;
    chart.draw(time, [
      { label: "measurement", stroke: GREY, values: measurement, calm: true },
      { label: learnt.best.template, stroke: BLUE, values: model, calm: true },
    ]);
    const head = document.createElement("tr");
    head.append(cell("th", "model", { scope: "col", className: "words" }), cell("th", "process", { scope: "col", className: "words" }),
      cell("th", "fit, held back", { scope: "col" }), cell("td", ""));
    at("models").replaceChildren(head, ...learnt.models.map((one) => {
      const line = document.createElement("tr"), button = cell("button", "Use", { type: "button" }), last = cell("td", "");
      button.setAttribute("aria-label", `Use ${one.template}`);
      button.addEventListener("click", () => use(one.process));
      last.append(button);
      line.append(cell("th", one.template, { scope: "row", className: "words" }), cell("td", one.shown, { className: "words math" }),
        cell("td", `${one.fit_pct.toFixed(1)} %`), last);
      return line;
    }));
    if (learnt.success && !taken) await use(learnt.best.process);
  }

  at("learn").addEventListener("submit", async (event) => {
    event.preventDefault();
    const file = at("record").files[0];
    if (file.size > LARGEST) {
      say(`${file.name} has ${(file.size / 1e6).toFixed(1)} MB; allowed: up to ${LARGEST / 1e6} MB here, any size by fopid explore FILE`, false);
      return;
    }
    at("learn-progress").hidden = false;
    say("", true);
    const columns = at("columns").value.trim();
    const answer = await ask("learn", { name: file.name, content: await base64(file), ...(columns ? { columns } : {}) });
    at("learn-progress").hidden = true;
    if (answer.status === 200) await show(answer);
    else say(answer.message, false);
  });
  startLearning.show = show;
}
