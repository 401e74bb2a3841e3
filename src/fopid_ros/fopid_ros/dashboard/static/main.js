// The page: shows what the server tells, and asks it for what the person wants.

import * as autotune from "./autotune.js";
import * as health from "./health.js";
import { connect } from "./live.js";
import { ask } from "./page/ask.js";
import * as gains from "./page/gains.js";
import * as plots from "./page/plots.js";
import { csv, download, picture, stamp } from "./page/save.js";
import * as parameters from "./parameters.js";
import * as sets from "./sets.js";
import * as whatif from "./whatif.js";
import { showDefaults, showMethod, showProgress, showResult, tuningFields } from "./tuning.js";

const SILENT_AFTER = 1500;  // [ms]
const at = (id) => document.getElementById(id);
const page = {
  connected: false, mayChange: false, status: null, facts: null, autotuning: null, asked: new Set(), heard: -Infinity,
};

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

function tuningIsIdle() {
  const { status, autotuning, asked } = page;
  return Boolean(status?.tuner.present) && status.tuner.busy === null && !autotuning?.active
    && !["tune", "autotune"].some((what) => asked.has(what));
}

function showEnabled() {
  const { connected, mayChange, status, asked, autotuning } = page;
  const may = connected && mayChange, locked = Boolean(autotuning?.active);
  const controller = may && Boolean(status?.controller.present), changes = controller && !locked;
  const inputs = [...gains.GAINS, ...gains.GAINS.map((name) => `${name}-value`)];
  enable(inputs, changes);
  enable(["mode"], controller);
  enable(["apply"], changes && gains.changed() && gains.complete() && !asked.has("parameters"));
  enable(["discard"], gains.changed());
  enable(["rollback"], changes && Boolean(status.controller.previous) && !asked.has("rollback"));
  sets.enable(changes && !asked.has("gain_set"));
  for (const form of ["setpoint", "manual"]) for (const part of at(form).elements) part.disabled = !may;
  const tuner = may && Boolean(status?.tuner.present) && !locked;
  for (const part of at("tune").elements) part.disabled = !tuner;
  enable(["tune-start"], tuner && tuningIsIdle());
  enable(["result-take"], changes && Number.isFinite(page.status?.result?.gains.kp));
  autotune.enable({ may, idle: tuningIsIdle() && controller });
  parameters.enable(may);
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
  const lost = page.connected ? "" : "no connection to the dashboard's server; nothing is known of the loop";
  health.showBar(page.facts, lost);
  if (!page.connected) health.showFacts(null);
}

function showAll() {
  showConnection();
  showEnabled();
}

function showStatus(status) {
  page.status = status;
  const { values, ranges, previous } = status.controller;
  gains.update(values, ranges);
  whatif.update(values, status.tuner.values.process);
  at("previous").textContent = previous
    ? `Before: ${gains.GAINS.map((name) => `${name} ${gains.text(previous[name])}`).join(", ")}` : "";
  for (const radio of at("mode").querySelectorAll("input")) radio.checked = radio.value === values.mode;
  at("manual").hidden = values.mode !== "manual";
  plots.setMarks(status.marks);
  plots.setUnits(status.units);
  health.setUnits(status.units);
  showDefaults(status.tuner);
  showProgress(status.tuner);
  showResult(status.result);
  showAll();
}

function showFacts(facts) {
  page.facts = facts;
  health.showBar(facts);
  health.showFacts(facts);
}

function showAutotuning(told) {
  const before = page.autotuning;
  page.autotuning = told;
  autotune.show(told);
  if (before?.active !== told.active || before?.result?.stamp !== told.result?.stamp) showEnabled();
}

function onMessage(message) {
  if (message.status) showStatus(message.status);
  if (message.autotuning) showAutotuning(message.autotuning);
  if (message.gain_sets) sets.show(message.gain_sets);
  if (message.diagnostics) health.showDiagnostics(message.diagnostics);
  if (message.facts) showFacts(message.facts);
  if (message.rows.length > 0) {
    page.heard = performance.now();
    at("no-signals").hidden = true;
  }
  if (message.rows.length > 0 || message.fresh) plots.append(message.rows, message.fresh);
}

function onSubmit(id, act) {
  at(id).addEventListener("submit", (event) => {
    event.preventDefault();
    act();
  });
}

// What would not hold the loop, as far as is known, is applied only when it is asked for twice.
async function applyGains() {
  const wanted = gains.all(), objection = await whatif.objection(wanted, page.status.tuner.values["verify.ms_max"]);
  if (objection) {
    say("gains-answer", { status: 0, message: `Not applied: ${objection}. To apply these gains nevertheless, press Apply again.` });
    at("apply").textContent = "Apply nevertheless";
    return;
  }
  if (await askFor("parameters", wanted, "gains-answer")) gains.discard();
}

let lastWanted = "";
function gainsMoved() {
  const wanted = JSON.stringify(gains.all());
  if (wanted !== lastWanted) {
    lastWanted = wanted;
    at("apply").textContent = "Apply";
    whatif.forgetConfirmation();
  }
  showEnabled();
  whatif.moved();
}

async function bringBack(number) {
  if (await askFor("gain_set", { number }, "sets-answer")) gains.discard();
}

function listenToPlots() {
  at("window").addEventListener("change", () => plots.setWindow(Number(at("window").value)));
  at("earlier").addEventListener("click", () => plots.shift(-0.25));
  at("later").addEventListener("click", () => plots.shift(0.25));
  at("zoom-in").addEventListener("click", () => plots.zoom(0.6));
  at("zoom-out").addEventListener("click", () => plots.zoom(1 / 0.6));
  at("live").addEventListener("click", () => (at("pause").getAttribute("aria-pressed") === "true" ? pause() : plots.live()));
  at("pause").addEventListener("click", pause);
  at("save-csv").addEventListener("click", () => {
    download(`loop_${stamp()}.csv`, new Blob([csv(plots.shownData())], { type: "text/csv" }));
  });
  at("save-png").addEventListener("click", async () => download(`loop_${stamp()}.png`, await picture(plots.canvases())));
}

function pause() {
  const paused = at("pause").getAttribute("aria-pressed") !== "true";
  at("pause").setAttribute("aria-pressed", String(paused));
  at("pause").textContent = paused ? "Go on" : "Pause";
  plots.setPaused(paused);
}

function showTab(name) {
  for (const tab of ["loop", "parameters"]) {
    at(`page-${tab}`).hidden = tab !== name;
    at(`tab-${tab}`).setAttribute("aria-selected", String(tab === name));
  }
  parameters.open(name === "parameters");
}

function listenToTabs() {
  for (const tab of ["loop", "parameters"]) {
    at(`tab-${tab}`).addEventListener("click", () => showTab(tab));
    at(`tab-${tab}`).addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      const other = tab === "loop" ? "parameters" : "loop";
      showTab(other);
      at(`tab-${other}`).focus();
    });
  }
}

function listen() {
  onSubmit("gains", applyGains);
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
  listenToPlots();
  listenToTabs();
}

gains.start(gainsMoved);
whatif.start();
sets.start(bringBack);
autotune.start({
  ready: () => page.connected && page.mayChange && tuningIsIdle() && Boolean(page.status?.controller.present),
  start: (goal) => askFor("autotune", goal, "autotune-answer"),
  accept: (trial) => askFor("autotune", trial, "autotune-answer"),
  cancel: () => askFor("cancel", {}, "autotune-answer"),
  reject: () => askFor("reject", {}, "autotune-answer"),
});
parameters.start(() => askFor("save", {}, "parameters-answer"));
health.start();
plots.setKnown((name) => {
  const { values } = page.facts ?? {};
  return !values || !(name in values) ? page.facts?.silent_for === null : values[name] !== null;
});
plots.start(({ live }) => { at("live").disabled = live; });
listen();
showMethod();
showAll();
setInterval(showConnection, 500);
connect({
  onMessage,
  onOpen: (mayChange) => {
    Object.assign(page, { connected: true, mayChange });
    showAll();
    autotune.plan();
  },
  onLost: () => {
    page.connected = false;
    page.facts = null;
    showAll();
  },
});
