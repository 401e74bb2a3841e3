// The page: shows what the server tells, and asks it for what the person wants.

import { connect } from "./live.js";
import { ask } from "./page/ask.js";
import { digits } from "./page/chart.js";
import * as gains from "./page/gains.js";
import * as plots from "./page/plots.js";
import { showDefaults, showMethod, showProgress, showResult, tuningFields } from "./tuning.js";

const SILENT_AFTER = 1500;  // [ms]
const at = (id) => document.getElementById(id);
const page = { connected: false, mayChange: false, status: null, asked: new Set(), heard: -Infinity };

function say(place, { status, message }) {
  at(place).textContent = message;
  at(place).className = `answer ${status === 200 ? "good" : "bad"}`;
}

// One request per kind at a time; the answer is shown at its place.
async function askFor(what, fields, place) {
  page.asked.add(what);
  at(place).textContent = "";
  showEnabled();
  const answer = await ask(what, fields);
  page.asked.delete(what);
  if (answer.status === 401) page.mayChange = false;
  say(place, answer);
  showAll();
  return answer.status === 200;
}

function enable(ids, on) {
  for (const id of ids) at(id).disabled = !on;
}

function showEnabled() {
  const { connected, mayChange, status, asked } = page;
  const may = connected && mayChange;
  const controller = may && Boolean(status?.controller.present);
  const inputs = [...gains.GAINS, ...gains.GAINS.map((name) => `${name}-value`)];
  enable([...inputs, "mode"], controller);
  enable(["apply"], controller && gains.changed() && gains.complete() && !asked.has("parameters"));
  enable(["discard"], gains.changed());
  enable(["rollback"], controller && Boolean(status.controller.previous) && !asked.has("rollback"));
  for (const form of ["setpoint", "manual"]) for (const part of at(form).elements) part.disabled = !may;
  const tuner = may && Boolean(status?.tuner.present);
  for (const part of at("tune").elements) part.disabled = !tuner;
  enable(["tune-start"], tuner && status.tuner.busy === null && !asked.has("tune"));
  enable(["result-take"], controller && Number.isFinite(page.status?.result?.gains.kp));
}

function connectionText() {
  const { connected, status } = page;
  if (!connected) return ["bad", "no connection to the dashboard's server; trying again"];
  if (!status?.controller.present) return ["bad", `no controller: ${status?.controller.name ?? ""} does not answer`];
  const tuner = status.tuner.present ? "" : `; no tuner: ${status.tuner.name} does not answer`;
  const { name, values } = status.controller;
  const silent = performance.now() - page.heard > SILENT_AFTER;
  const mode = values.mode ? `, ${values.mode}` : "";
  return [silent ? "" : "good", `${name}${mode}${silent ? ", no signals now" : ""}${tuner}`];
}

function showConnection() {
  const [kind, text] = connectionText();
  if (at("connection").textContent !== text) at("connection").textContent = text;
  at("connection").className = `state ${kind}`;
  const access = page.mayChange || !page.connected
    ? "" : "Read only: to change something, open the address that the dashboard printed at its start.";
  if (at("access").textContent !== access) at("access").textContent = access;
}

function showAll() {
  showConnection();
  showEnabled();
}

function showStatus(status) {
  page.status = status;
  const { values, ranges, previous } = status.controller;
  gains.update(values, ranges);
  at("previous").textContent = previous
    ? `Before: ${gains.GAINS.map((name) => `${name} ${gains.text(previous[name])}`).join(", ")}` : "";
  for (const radio of at("mode").querySelectorAll("input")) radio.checked = radio.value === values.mode;
  at("manual").hidden = values.mode !== "manual";
  plots.setMarks(status.marks);
  showDefaults(status.tuner);
  showProgress(status.tuner);
  showResult(status.result);
  showAll();
}

function showNow({ facts }) {
  const [, setpoint, measurement, control] = plots.latest();
  Object.entries({ setpoint, measurement, control }).forEach(([name, value]) => {
    at(`now-${name}`).textContent = digits(value);
  });
  if (!facts) return;
  at("now-saturated").textContent = facts.saturated ? "yes" : "no";
  at("now-interval").textContent = facts.interval === null ? "–" : `${digits(facts.interval * 1000)} ms`;
  at("now-overruns").textContent = facts.overruns.toLocaleString("en");
}

let lastNow = -Infinity, newest = {};
function onMessage(message) {
  if (message.status) showStatus(message.status);
  if (message.rows.length === 0 && !message.fresh) return;
  if (message.rows.length > 0) {
    page.heard = performance.now();
    at("no-signals").hidden = true;
  }
  plots.append(message.rows, message.fresh);
  newest = { ...newest, ...message };
  if (performance.now() - lastNow > 250) {  // no faster than can be read
    lastNow = performance.now();
    showNow(newest);
  }
}

function onSubmit(id, act) {
  at(id).addEventListener("submit", (event) => {
    event.preventDefault();
    act();
  });
}

function listen() {
  onSubmit("gains", async () => {
    if (await askFor("parameters", gains.all(), "gains-answer")) gains.discard();
  });
  at("discard").addEventListener("click", gains.discard);
  at("rollback").addEventListener("click", async () => {
    if (await askFor("rollback", {}, "gains-answer")) gains.discard();
  });
  for (const radio of at("mode").querySelectorAll("input")) {
    radio.addEventListener("change", () => askFor("parameters", { mode: radio.value }, "loop-answer"));
  }
  for (const [form, signal] of [["setpoint", "setpoint"], ["manual", "manual_control"]]) {
    onSubmit(form, () => askFor("signal", { signal, value: at(`${form}-value`).valueAsNumber }, "loop-answer"));
  }
  onSubmit("tune", async () => {
    if (await askFor("tune", tuningFields(), "tune-answer")) say("tune-answer", { status: 200, message: "Done" });
  });
  at("tune-method").addEventListener("change", showMethod);
  at("result-take").addEventListener("click", () => gains.take(page.status.result.gains));
  at("window").addEventListener("change", () => plots.setWindow(Number(at("window").value)));
  at("pause").addEventListener("click", () => {
    const paused = at("pause").getAttribute("aria-pressed") !== "true";
    at("pause").setAttribute("aria-pressed", String(paused));
    at("pause").textContent = paused ? "Go on" : "Pause";
    plots.setPaused(paused);
  });
}

gains.start(showEnabled);
plots.start();
listen();
showMethod();
showAll();
setInterval(showConnection, 500);
connect({
  onMessage,
  onOpen: (mayChange) => {
    Object.assign(page, { connected: true, mayChange });
    showAll();
  },
  onLost: () => {
    page.connected = false;
    showAll();
  },
});
