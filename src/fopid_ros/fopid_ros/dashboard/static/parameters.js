// All parameters of controller, tuner and plant: described, with ranges, the refusal's text, reset and save.

import { ask } from "./page/ask.js";

const at = (id) => document.getElementById(id);
const TITLES = { controller: "Controller", tuner: "Tuner", plant: "Plant" };
const AGAIN = 2000;  // [ms] between two looks while the tab is open

const rows = new Map();  // "node name" -> its parts
const drafts = new Map();  // what was typed and is not set yet: it outlives a node that does not answer for once
let layout = "", timer = 0, may = false;

function element(tag, className, textContent = "") {
  return Object.assign(document.createElement(tag), { className, textContent });
}

function typed(value) {
  return Array.isArray(value) ? value.join(", ") : value === null || value === undefined ? "" : String(value);
}

function choices({ constraints }) {
  const found = constraints.match(/one of: ([^;]+)/);
  return found ? found[1].split(", ") : null;
}

function range({ low, high, constraints }) {
  const parts = [];
  if (low !== null || high !== null) parts.push(`${low ?? "no bound"} to ${high ?? "no bound"}`);
  if (constraints) parts.push(constraints);
  return parts.join(" · ");
}

function input(parameter) {
  const named = parameter.type === "bool" ? ["true", "false"] : choices(parameter);
  if (!named) return Object.assign(document.createElement("input"), { type: "text", spellcheck: false });
  const select = document.createElement("select");
  select.append(...named.map((name) => new Option(name, name)));
  return select;
}

function wanted({ type, value }, text) {
  if (type === "bool") return text === "true";
  return Array.isArray(value) ? text.split(",").map((one) => one.trim()).filter(Boolean) : text;
}

async function set(node, parts, text) {
  const answer = await ask("parameter", { node, name: parts.told.name, value: wanted(parts.told, text) });
  parts.answer.textContent = answer.message;
  parts.answer.className = `answer ${answer.status === 200 ? "good" : "bad"}`;
  if (answer.status === 200) {
    parts.dirty = false;
    drafts.delete(parts.field.id);
  }
  await read();
}

function makeRow(node, told) {
  const row = element("form", "parameter"), label = element("label", "", told.name), edit = element("div", "edit");
  row.autocomplete = "off";
  const field = input(told), id = `${node}.${told.name}`, reset = element("button", "", "Reset");
  const apply = element("button", "", "Set"), about = element("div", ""), answer = element("p", "answer");
  Object.assign(field, { id });
  label.htmlFor = id;
  apply.type = "submit";
  reset.type = "button";
  apply.setAttribute("aria-label", `Set ${told.name}`);
  reset.setAttribute("aria-label", `Reset ${told.name}`);
  answer.setAttribute("role", "status");
  about.id = `${id}-about`;
  field.setAttribute("aria-describedby", about.id);
  about.append(element("p", "", told.description), element("small", "", range(told)));
  edit.append(field, apply, reset);
  row.append(label, edit, about, answer);
  const parts = { row, field, apply, reset, answer, told, dirty: drafts.has(id) };
  if (parts.dirty) field.value = drafts.get(id);
  field.addEventListener("input", () => {
    parts.dirty = field.value !== typed(parts.told.value);
    if (parts.dirty) drafts.set(id, field.value);
    else drafts.delete(id);
    enableRow(parts);
  });
  row.addEventListener("submit", (event) => {
    event.preventDefault();
    set(node, parts, field.value);
  });
  reset.addEventListener("click", () => set(node, parts, typed(parts.told.first)));
  rows.set(id, parts);
  return row;
}

function enableRow({ told, field, apply, reset, dirty }) {
  const fixed = told.read_only || !may;
  field.disabled = fixed;
  apply.disabled = fixed || !dirty;
  reset.disabled = fixed || typed(told.value) === typed(told.first);
  reset.title = `to ${typed(told.first) || "nothing"}, as it was when the page first saw it`;
}

function refresh(parts, told) {
  parts.told = told;
  parts.row.classList.toggle("changed", typed(told.value) !== typed(told.first));
  if (!parts.dirty && document.activeElement !== parts.field) parts.field.value = typed(told.value);
  enableRow(parts);
}

function build(nodes) {
  rows.clear();
  at("parameters").replaceChildren(...Object.entries(nodes).flatMap(([node, { name, parameters }]) => {
    const title = element("h2", "", `${TITLES[node]}  ${name}`);
    if (!parameters) return [title, element("p", "quiet", "not there, or it does not answer")];
    return [title, ...parameters.map((told) => makeRow(node, told))];
  }));
}

function filter() {
  const text = at("parameter-filter").value.toLowerCase(), changed = at("parameter-changed").checked;
  for (const { row, told } of rows.values()) {
    const fits = `${told.name} ${told.description}`.toLowerCase().includes(text);
    row.hidden = !fits || (changed && typed(told.value) === typed(told.first));
    row.style.display = row.hidden ? "none" : "";
  }
}

async function read() {
  let nodes;
  try {
    nodes = await (await fetch("parameters")).json();
  } catch {
    return;  // the bar on top says that nothing answers
  }
  const now = JSON.stringify(Object.entries(nodes).map(([node, { parameters }]) => [node, parameters?.map(({ name }) => name)]));
  if (now !== layout) {
    layout = now;
    build(nodes);
  }
  for (const [node, { parameters }] of Object.entries(nodes)) {
    for (const told of parameters ?? []) refresh(rows.get(`${node}.${told.name}`), told);
  }
  filter();
}

// Look as long as the tab is open.
export function open(shown) {
  clearInterval(timer);
  if (!shown) return;
  read();
  timer = setInterval(read, AGAIN);
}

export function enable(on) {
  if (may === on) return;
  may = on;
  at("save-gains").disabled = !on;
  for (const parts of rows.values()) enableRow(parts);
}

export function start(save) {
  at("save-gains").disabled = true;
  at("save-gains").addEventListener("click", save);
  at("parameter-filter").addEventListener("input", filter);
  at("parameter-changed").addEventListener("change", filter);
}
