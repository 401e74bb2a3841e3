// The bar on top and the figures below it: how the loop is, in the worst word that is known to be true.

import { digits } from "./page/chart.js";

const at = (id) => document.getElementById(id);
const WORDS = { ok: "Good", warn: "Warning", error: "Error", unknown: "Not known" };
const HUGE = 1e6;  // numbers from here on are told as what they are: huge
const OLD = 1;  // [s] an age that is worth a word

let units = {}, said = "";

function put(id, text) {
  if (at(id).textContent !== text) at(id).textContent = text;
}

function short(name) {
  return name.replace(/^\//, "");
}

function seconds(age) {
  return age < 10 ? `${age.toFixed(1)} s` : age < 120 ? `${age.toFixed(0)} s` : `${(age / 60).toFixed(0)} min`;
}

function number(value, unit = "") {
  return value === null || value === undefined ? "–" : `${digits(value)}${unit ? ` ${unit}` : ""}`;
}

export function setUnits(named) {
  units = named;
}

// The bar; `lost` tells why nothing is known, where nothing comes at all.
export function showBar(facts, lost = "") {
  const level = lost ? "error" : facts?.level ?? "unknown", worst = facts?.problems ?? [];
  if (at("health").dataset.level !== level) at("health").dataset.level = level;
  put("health-word", WORDS[level]);
  const more = worst.length > 1 ? `  (+${worst.length - 1} more)` : "";
  const text = lost || (worst.length ? `${short(worst[0].who)}: ${worst[0].text}${more}`
    : level === "ok" ? "nothing to worry about" : "nothing has been heard of the loop yet");
  put("health-text", text);
  // A voice says what is new, not each second that passes.
  const news = lost || (worst.length ? `${WORDS[level]}: ${worst.map(({ who, text: what }) => `${short(who)} ${what}`)
    .join("; ").replace(/[\d.]+(e[+-]?\d+)? s\b/g, "some time")}` : WORDS[level]);
  if (news !== said) put("health-said", said = news);
}

export function showDiagnostics(nodes) {
  at("diagnostics").replaceChildren(...nodes.map(({ name, level, text }) => {
    const item = document.createElement("li"), word = document.createElement("b");
    word.textContent = WORDS[level];
    item.append(word, ` ${short(name)}: ${text}`);
    return item;
  }));
}

function showAge(id, age) {
  put(id, age === null || age === undefined ? "" : age < OLD ? "now" : `${seconds(age)} old`);
}

export function showFacts(facts) {
  const { values, ages } = facts ?? { values: {}, ages: {} };
  for (const name of ["setpoint", "measurement", "control"]) {
    const value = values[name] ?? null;
    put(`now-${name}`, number(value, units[name === "control" ? "control" : "measurement"]));
    at(`now-${name}`).className = value !== null && Math.abs(value) >= HUGE ? "bad" : "";
  }
  showAge("age-setpoint", ages.setpoint);
  showAge("age-measurement", ages.measurement);
  at("age-measurement").className = facts?.stale ? "bad" : "";
  const known = (value, text) => (value === null || value === undefined ? "–" : text(value));
  put("now-saturated", known(facts?.saturated, (on) => (on ? "yes" : "no")));
  at("now-saturated").className = facts?.saturated ? "bad" : "";
  put("now-mode", known(facts?.mode, (mode) => mode));
  put("now-refused", known(facts?.refused, (count) => count.toLocaleString("en")));
  at("now-refused").className = facts?.refused_lately ? "bad" : "";
  put("now-adaptation", known(facts?.adaptation, (text) => text));
  put("now-interval", known(facts?.interval, (interval) => `${Number((interval * 1000).toPrecision(3))} ms`));
  put("now-overruns", known(facts?.overruns, (count) => count.toLocaleString("en")));
}

export function start() {
  at("health-more").addEventListener("click", () => {
    const open = at("health-list").hidden;
    at("health-list").hidden = !open;
    at("health-more").setAttribute("aria-expanded", String(open));
  });
}
