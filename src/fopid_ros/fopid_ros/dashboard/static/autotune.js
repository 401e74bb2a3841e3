// The guided autotuning: what it will do, how it goes, what was learnt, and what a person makes of it.

import { ask } from "./page/ask.js";
import { digits } from "./page/chart.js";
import { GAINS, text } from "./page/gains.js";
import * as plots from "./page/plots.js";

const at = (id) => document.getElementById(id);
const PLAN_AFTER = 500;  // [ms] after the last change of a field
const PLAN_AGAIN = 3000;  // [ms] when there was none
const NUMBERS = ["amplitude", "deviation_max", "duration", "ms_max"];
const HELD = ["control_rate_max", "setpoint_rate_max", "deadband"];  // of a proposal; 0 for as it is
const LEFT = { white: "noise", not: "more than noise" };

let planned = 0, wanted = null, shownResult = null, act = {}, chosen = null;

// A transfer function with as many digits as can be read.
export function brief(process) {
  return process.replace(/\d+\.\d+(e[+-]?\d+)?/g, (number) => Number(Number(number).toPrecision(4)).toString());
}

function element(tag, className, textContent) {
  return Object.assign(document.createElement(tag), { className, textContent });
}

function put(id, textContent) {
  if (at(id).textContent !== textContent) at(id).textContent = textContent;
}

function seconds(time) {
  return time < 100 ? `${digits(Number(time.toPrecision(2)))} s` : `${(time / 60).toFixed(1)} min`;
}

export function goal() {
  const fields = { propose_only: at("autotune-propose").checked };
  if (at("autotune-excitation").value) fields.excitation = at("autotune-excitation").value;
  if (at("autotune-method").value) fields.method = at("autotune-method").value;
  for (const name of NUMBERS) {
    if (at(`autotune-${name}`).value !== "") fields[name] = at(`autotune-${name}`).valueAsNumber;
  }
  if (at("autotune-phase_margin").value !== "") fields.phase_margin_deg = at("autotune-phase_margin").valueAsNumber;
  return fields;
}

// What it will do, before it starts; asked of the tuner itself.
export function plan() {
  clearTimeout(planned);
  planned = setTimeout(async () => {
    if (!act.ready()) return;
    const fields = goal(), key = JSON.stringify(fields);
    wanted = key;
    const answer = await ask("plan", fields);
    if (wanted === key && act.ready()) showPlan(answer);
  }, PLAN_AFTER);
}

function showPlan({ status, message, plan: steps, duration }) {
  const known = status === 200 && Boolean(steps);
  if (!known) planned = setTimeout(plan, PLAN_AGAIN);
  put("plan-time", known ? `About ${seconds(duration)} in all.` : message);
  at("plan-time").className = known ? "quiet" : "warning";
  at("plan-steps").replaceChildren(...(known ? steps : []).map((step) => {
    const item = document.createElement("li"), [, name, rest] = step.match(/^([^:]+)(:.*)?$/s);
    item.append(element("b", "", name), rest ?? "");
    return item;
  }));
}

function showPhases({ order, stage }) {
  const present = order.indexOf(stage?.phase);
  if (at("phases").children.length !== order.length) {
    at("phases").replaceChildren(...order.map((name) => element("li", "", name)));
  }
  [...at("phases").children].forEach((item, index) => {
    item.className = index < present ? "past" : "";
    if (index === present) item.setAttribute("aria-current", "step");
    else item.removeAttribute("aria-current");
  });
}

function showProgress(told) {
  const { stage, here, elapsed, canceling } = told;
  showPhases(told);
  put("autotuning-who", `${here ? "Started here" : "Started elsewhere: from a terminal, or another page"}.`
    + " Gains and other tunings are locked.");
  at("autotuning-progress").value = stage?.progress ?? 0;
  const parts = [`${elapsed ?? 0} s so far`];
  if (stage?.remaining) parts.push(`${seconds(stage.remaining)} left ${stage.phase === "measuring" ? "in all" : "in this phase"}`);
  if (stage?.deviation) parts.push(`off the setpoint by ${Number(stage.deviation.toPrecision(2))}`);
  if (stage?.fit_pct) parts.push(`fit ${stage.fit_pct.toFixed(1)} %`);
  put("autotuning-text", canceling ? "cancelling; the tuner puts everything back" : parts.join(" · "));
  put("autotuning-message", stage?.message ?? "");
}

// The record as it grows: the plots follow it from its beginning, each phase tinted.
function showRecord({ active, phases }) {
  const known = phases.filter(({ from }) => from !== null);
  plots.setPhases(known.map((phase, index) => (
    { ...phase, to: known[index + 1]?.from ?? (active ? null : phase.from) }
  )).filter(({ from, to }) => to === null || to > from));
}

function title({ success, applied, rolled_back: back, canceled, gains }) {
  if (canceled) return "Cancelled: everything is as it was";
  if (applied) return "Applied, watched and kept";
  if (back) return "Taken back: the loop got worse";
  if (success && gains) return "Found; nothing is applied yet";
  return "Failed: nothing was changed";
}

function terms(pairs) {
  return pairs.filter(([, value]) => value !== null && value !== undefined)
    .flatMap(([name, value]) => [element("dt", "", name), element("dd", "tabular", value)]);
}

// What is asked for to try a proposal: its whole design, judged on the process it was found for.
function trialOf({ gains, two_degrees: more, ...rest }, model) {
  const whole = more && Object.values(more).every((value) => value !== null);
  const held = Object.fromEntries(HELD.filter((name) => rest[name]).map((name) => [name, rest[name]]));
  return { gains, process: model?.process ?? "", ...(whole ? { two_degrees: more } : {}), ...held };
}

function showOutcome(result) {
  const { success, applied, canceled, message, advice, model, gains, achieved, worst_ms: worst, elapsed } = result;
  at("outcome-title").textContent = title(result);
  at("outcome-message").textContent = message;
  at("outcome-message").className = success ? "" : "warning";
  at("outcome-advice").textContent = success || canceled ? "" : advice;
  chosen = success && !applied ? trialOf(result.proposals.find(({ accepted }) => accepted) ?? { gains }, model) : null;
  const fit = model && model.fit !== null ? `${model.fit.toFixed(1)} %` : null;
  at("outcome-measures").replaceChildren(...terms([
    ["model", model ? brief(model.process) : null], ["fit on held-back data", fit],
    ...(success && gains ? GAINS.map((name) => [name, text(gains[name])]) : []),
    ["phase margin", success && achieved?.phase_margin ? `${(achieved.phase_margin * 180 / Math.PI).toFixed(1)}°` : null],
    ["max |S|", success && achieved?.ms ? achieved.ms.toFixed(3) : null],
    ["worst that is possible", success && worst ? worst.toFixed(3) : null],
    ["took", elapsed ? seconds(elapsed) : null],
  ]));
}

function words(content) {
  return element("td", "words", content);
}

function figure(value, places = 3) {
  return element("td", "", value === null || value === undefined ? "–" : Number(value.toPrecision(places)).toString());
}

function modelRow(model, index) {
  const row = document.createElement("tr");
  row.append(words(index === 0 ? `${model.name} (preferred)` : model.name), words(brief(model.process)),
    element("td", "", model.fit === null ? "–" : `${model.fit.toFixed(1)} %`), words(model.white ? LEFT.white : LEFT.not));
  return row;
}

function proposalRow(proposal, { applied, success, model }) {
  const row = document.createElement("tr"), last = document.createElement("td"), { accepted, message } = proposal;
  row.className = accepted ? "" : "refused";
  const name = words(proposal.name);
  if (!accepted) name.append(element("small", "", message));
  if (accepted && success && !applied && proposal.gains) {
    const button = element("button", "", "Accept");
    button.type = "button";
    button.dataset.changes = "gains";
    button.setAttribute("aria-label", `Accept ${proposal.name}: apply and watch`);
    button.addEventListener("click", () => act.accept(trialOf(proposal, model)));
    last.append(button);
  }
  row.append(name, last, ...GAINS.map((gain) => figure(proposal.gains?.[gain], 4)), figure(proposal.setpoint_iae),
    figure(proposal.load_iae), figure(proposal.achieved.ms), figure(proposal.worst_ms), figure(proposal.noise_gain));
  return row;
}

function showLearnt(result) {
  const { models, proposals } = result ?? { models: [], proposals: [] };
  at("learnt").hidden = !models.length && !proposals.length;
  at("learnt-models-part").hidden = !models.length;
  at("learnt-proposals-part").hidden = !proposals.length;
  at("learnt-models").replaceChildren(...models.map(modelRow));
  at("learnt-proposals").replaceChildren(...proposals.map((proposal) => proposalRow(proposal, result)));
}

let wasActive = null;
export function show(told) {
  const { active, result } = told;
  at("autotune").hidden = active;
  at("autotuning").hidden = !active;
  at("locked").hidden = !active;
  at("outcome").hidden = active || result === null;
  if (active) showProgress(told);
  showRecord(told);
  if (active !== wasActive) {
    wasActive = active;
    if (!active) plan();
  }
  if (result?.stamp === shownResult) return;
  shownResult = result?.stamp;
  if (result) showOutcome(result);
  else chosen = null;
  showLearnt(result);
}

export function enable({ may, idle }) {
  for (const part of at("autotune").elements) part.disabled = !may || !idle;
  at("autotune-cancel").disabled = !may;
  at("accept").hidden = chosen === null;
  at("accept").disabled = !may || !idle;
  at("reject").disabled = !may;
  for (const button of at("learnt").querySelectorAll("button")) button.disabled = !may || !idle;
}

// `actions`: start, cancel, accept, reject do what they say; ready tells whether a plan can be asked for.
export function start(actions) {
  act = actions;
  at("autotune").addEventListener("submit", (event) => {
    event.preventDefault();
    act.start(goal());
  });
  at("autotune").addEventListener("input", plan);
  at("autotune-cancel").addEventListener("click", () => act.cancel());
  at("accept").addEventListener("click", () => act.accept(chosen));
  at("reject").addEventListener("click", () => act.reject());
}
