// All gain sets of the run: who, when, why, verified or not; any of them comes back with one click.

import { digits } from "./page/chart.js";
import { GAINS, text } from "./page/gains.js";

const at = (id) => document.getElementById(id);
let shown = "", bringBack = () => {}, mayBring = false;

function element(tag, className, textContent) {
  return Object.assign(document.createElement(tag), { className, textContent });
}

function formula(gains) {
  return GAINS.filter((name) => name in gains).map((name) => `${name} ${digits(gains[name])}`).join("  ");
}

function state({ status, ended, proved }) {
  if (status === "verified") return ["verified", proved ? "verified, with a proof" : "verified"];
  if (status === "trial") return ["trial", ended ? `on trial, ${ended}` : "on trial"];
  return ["", "not verified"];
}

function row(set) {
  const item = document.createElement("li"), words = document.createElement("div");
  const [kind, told] = state(set), when = new Date(set.since * 1000).toLocaleTimeString("en-GB");
  words.append(element("span", "tabular", formula(set.gains)));
  words.append(element("small", "", `${set.number} · ${when} · ${set.origin || "by somebody unnamed"}`));
  words.append(element("small", kind, told));
  item.append(words);
  if (set.present) {
    item.append(element("b", "", "runs now"));
  } else {
    const button = element("button", "", "Back");
    button.type = "button";
    button.setAttribute("aria-label", `Back to set ${set.number}: ${formula(set.gains)}, ${told}`);
    button.addEventListener("click", () => bringBack(set.number));
    item.append(button);
  }
  return item;
}

function lastVerified(sets) {
  return sets.find(({ status }) => status === "verified");
}

export function show(sets) {
  const now = JSON.stringify(sets);
  if (now === shown) return;
  shown = now;
  at("gain-sets").replaceChildren(...sets.map(row));
  const verified = lastVerified(sets);
  at("last-verified").dataset.number = verified && !verified.present ? verified.number : "";
  at("last-verified-text").textContent = !verified ? "No set has been verified yet."
    : `${verified.present ? "Runs now" : `Set ${verified.number}`}: ${GAINS.map((name) => `${name} ${text(verified.gains[name])}`).join(", ")}`;
  enable(mayBring);
}

export function enable(on) {
  mayBring = on;
  for (const button of at("gain-sets").querySelectorAll("button")) button.disabled = !on;
  at("last-verified").disabled = !on || !at("last-verified").dataset.number;
}

export function start(onBack) {
  bringBack = onBack;
  at("last-verified").addEventListener("click", () => bringBack(Number(at("last-verified").dataset.number)));
}
