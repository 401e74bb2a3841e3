// What would happen with the gains on the sliders, on the process that the tuner knows.

import { ask } from "./page/ask.js";
import * as gains from "./page/gains.js";
import { createPrediction } from "./page/prediction.js";
import { brief } from "./autotune.js";

const at = (id) => document.getElementById(id);
let prediction = null, process = "", present = {}, shown = "", confirmed = "";

async function predict(fields) {
  const answer = await ask("predict", fields);
  return answer.refused ? { status: 400, message: answer.refused } : answer;
}

function draw() {
  at("prediction").hidden = !process;
  at("prediction-of").textContent = process ? `On the tuner's process, ${brief(process)}.`
    : "A process is not known yet: the tuner needs one, given or learnt.";
  if (!process || !at("prediction-part").open || !gains.complete()) return;
  const sets = [{ label: "runs now", kind: "baseline", gains: present }];
  if (gains.changed()) sets.push({ label: "on the sliders", kind: "new", gains: gains.all() });
  const key = JSON.stringify([process, sets]);
  if (key === shown) return;
  shown = key;
  prediction ??= createPrediction(at("prediction"), predict);
  prediction.show({ process, sets, begun: performance.now() });
}

// What the controller runs with, and the tuner's process.
export function update(values, known) {
  present = Object.fromEntries(gains.GAINS.map((name) => [name, values[name]]));
  process = known ?? "";
  draw();
}

// The sliders have moved.
export function moved() {
  if (process && gains.changed()) at("prediction-part").open = true;
  draw();
}

// Why gains should not be applied, as far as is known; empty when they may, or when that was confirmed.
export async function objection(wanted, msMax) {
  const key = JSON.stringify(wanted);
  if (!process || key === confirmed) return "";
  const answer = await predict({ process, sets: [wanted] });
  if (answer.status !== 200) return "";
  const [{ verdict, margins }] = answer.sets, ms = margins.ms.value;
  const unstable = verdict.badge !== "stable" ? `the loop would be ${verdict.badge} on the tuner's process` : "";
  const sharp = !unstable && ms !== null && msMax && ms > msMax ? `max |S| would be ${ms.toPrecision(3)}, above ${msMax}` : "";
  if (unstable || sharp) confirmed = key;
  return unstable || sharp;
}

export function forgetConfirmation() {
  confirmed = "";
}

export function start() {
  at("prediction-part").addEventListener("toggle", draw);
}
