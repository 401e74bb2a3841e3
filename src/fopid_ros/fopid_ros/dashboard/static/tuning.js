// The tuning's form and what the newest tuning came to.

import { brief } from "./autotune.js";

const at = (id) => document.getElementById(id);
const DEGREE = Math.PI / 180;
const NUMBERS = ["phase_margin", "crossover", "ms_max", "u_max"];
const MEASURES = [
  ["phase_margin", "phase margin", (value) => `${(value / DEGREE).toFixed(1)}°`],
  ["crossover", "crossover", (value) => `${value.toPrecision(4)} rad/s`],
  ["gain_margin_db", "gain margin", (value) => `${value.toFixed(1)} dB`],
  ["ms", "max |S|", (value) => value.toFixed(3)],
  ["mt", "max |T|", (value) => value.toFixed(3)],
];

let methodSet = false;

function shown(method) {
  return (element) => !element.dataset.method || element.dataset.method === method;
}

export function showMethod() {
  const fits = shown(at("tune-method").value);
  for (const element of at("tune").querySelectorAll("[data-method]")) element.hidden = !fits(element);
}

// What is left empty is the tuner's own: it stands in the field as a hint.
export function showDefaults({ values }) {
  for (const name of NUMBERS) {
    const value = name === "phase_margin" ? values[name] / DEGREE : values[name];
    at(`tune-${name}`).placeholder = value ? `${Number(value.toPrecision(5))}` : "left to the method";
  }
  at("tune-process").placeholder = values.process || "none yet";
  if (values.index) at("tune-index").options[0].textContent = values.index;
  if (!methodSet && ["frequency", "time"].includes(values.method)) {
    methodSet = true;
    at("tune-method").value = values.method;
    showMethod();
  }
}

export function tuningFields() {
  const method = at("tune-method").value;
  const fields = { method, process: at("tune-process").value.trim(), apply: at("tune-apply").checked };
  if (method === "time") fields.index = at("tune-index").value;
  for (const name of NUMBERS) {
    const input = at(`tune-${name}`);
    if (!shown(method)(input) || input.value === "") continue;
    fields[name === "phase_margin" ? "phase_margin_deg" : name] = input.valueAsNumber;
  }
  return fields;
}

export function showProgress({ busy }) {
  const text = busy === null ? "Tune" : `Tuning, ${busy} s`;
  if (at("tune-start").textContent !== text) at("tune-start").textContent = text;
  at("tune-progress").hidden = busy === null;
}

function element(tag, textContent) {
  return Object.assign(document.createElement(tag), { textContent });
}

function terms(pairs) {
  return pairs.flatMap(([name, value]) => [element("dt", name), element("dd", value)]);
}

function fill(result) {
  const { method, process, success, applied, message, unmet, gains, achieved, elapsed } = result;
  at("result-title").textContent = `Tuned by ${method}, ${applied ? "applied" : "not applied"}`;
  at("result-message").textContent = message;
  at("result-message").className = success ? "" : "warning";
  at("result-advice").textContent = success ? "" : result.advice;
  at("result-take").hidden = !success;
  at("result-unmet").replaceChildren(...unmet.map((text) => element("li", text)));
  at("result-measures").replaceChildren(...terms([
    ["process", brief(process)],
    ...(success ? Object.entries(gains) : []).map(([name, value]) => [name, Number(value?.toPrecision(6)).toString()]),
    ...MEASURES.filter(([name]) => achieved[name] !== null).map(([name, label, text]) => [label, text(achieved[name])]),
    ["took", elapsed === null ? "–" : `${elapsed.toPrecision(3)} s`],
  ]));
}

let shownStamp = null;
export function showResult(result) {
  const shown = result !== null && !/^(autotune|trial)/.test(result.method);  // those are told beside the plots
  at("result").hidden = !shown;
  if (!shown || result.stamp === shownStamp) return;
  shownStamp = result.stamp;
  fill(result);
}
