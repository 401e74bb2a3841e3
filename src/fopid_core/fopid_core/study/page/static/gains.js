// The five gains: a slider and a field each, and what of them is not applied yet.

export const GAINS = ["kp", "ki", "kd", "lam", "mu"];
const NAMES = {
  kp: "proportional gain", ki: "integral gain", kd: "derivative gain",
  lam: "order of the integral", mu: "order of the derivative",
};
const WIDE = 4;  // a range beyond this is too wide for a slider
const DECADES = 1;  // a slider of such a gain reaches this far up and down from the present value
const STEPS = 1000;

const parts = {};
const draft = {};  // what was moved and is not applied yet
let present = {}, ranges = {}, whenChanged = () => {};

export function text(value) {
  return value === undefined ? "–" : Number(value.toPrecision(6)).toString();
}

function clip(value, [low, high]) {
  return Math.min(Math.max(value, low), high);
}

function bounds(name) {
  const [low, high] = ranges[name] ?? [null, null];
  return [low ?? -Infinity, high ?? Infinity];
}

// How a slider's place, 0 to 1, belongs to a value: never a value outside the range the controller allows.
function scale(name) {
  const [low, high] = bounds(name), value = present[name] ?? 0;
  if (high - low <= WIDE) return { at: (p) => low + p * (high - low), place: (v) => (v - low) / (high - low) };
  if (value === 0) {
    const ends = [clip(0, [low, high]), clip(1, [low, high])];
    return { at: (p) => ends[0] + p * (ends[1] - ends[0]), place: (v) => (v - ends[0]) / (ends[1] - ends[0] || 1) };
  }
  return {
    at: (p) => clip(value * 10 ** ((2 * p - 1) * DECADES), [low, high]),
    place: (v) => (v / value > 0 ? (Math.log10(v / value) / DECADES + 1) / 2 : 0),
  };
}

function wanted(name) {
  return name in draft ? draft[name] : present[name];
}

function show(name, { field = true } = {}) {
  const { row, slider, number, note } = parts[name], value = wanted(name), known = present[name] !== undefined;
  row.classList.toggle("changed", name in draft);
  slider.value = known && Number.isFinite(value) ? clip(Math.round(scale(name).place(value) * STEPS), [0, STEPS]) : 0;
  slider.setAttribute("aria-valuetext", text(value));
  if (field) number.value = value === undefined || Number.isNaN(value) ? "" : text(value);
  const ends = known ? [0, 1].map((place) => text(scale(name).at(place))).join(" to ") : "";
  note.textContent = known ? `runs with ${text(present[name])} · slider ${ends}` : "";
}

function move(name, value, options) {
  if (text(value) === text(present[name] ?? NaN)) delete draft[name];
  else draft[name] = value;
  show(name, options);
  whenChanged();
}

function makeRow(name) {
  const row = document.createElement("div");
  row.className = "gain";
  row.innerHTML = `<label for="${name}-value" title="${NAMES[name]}">${name}</label>
    <input id="${name}" type="range" min="0" max="${STEPS}" aria-label="${name}, ${NAMES[name]}">
    <input id="${name}-value" type="number" step="any" aria-describedby="${name}-note">
    <small id="${name}-note"></small>`;
  const [slider, number] = row.querySelectorAll("input");
  parts[name] = { row, slider, number, note: row.querySelector("small") };
  slider.addEventListener("input", () => move(name, Number(text(scale(name).at(slider.value / STEPS)))));
  number.addEventListener("input", () => move(name, number.valueAsNumber, { field: false }));
  return row;
}

export function start(onChange) {
  whenChanged = onChange;
  document.getElementById("sliders").replaceChildren(...GAINS.map(makeRow));
  GAINS.forEach((name) => show(name));
}

// What the controller runs with and what it allows.
export function update(values, allowed) {
  ranges = allowed;
  for (const name of GAINS) {
    if (values[name] === present[name]) continue;
    present = { ...present, [name]: values[name] };
    if (name in draft && text(draft[name]) === text(values[name])) delete draft[name];
    if (document.activeElement !== parts[name].number || !(name in draft)) show(name);
  }
  GAINS.forEach((name) => show(name, { field: document.activeElement !== parts[name].number }));
  whenChanged();
}

export function changed() {
  return Object.keys(draft).length > 0;
}

export function complete() {
  return GAINS.every((name) => Number.isFinite(wanted(name)));
}

export function all() {
  return Object.fromEntries(GAINS.map((name) => [name, wanted(name)]));
}

export function discard() {
  for (const name of GAINS) delete draft[name];
  GAINS.forEach((name) => show(name));
  whenChanged();
}

// Put gains on the sliders without applying them.
export function take(gains) {
  for (const name of GAINS) move(name, gains[name]);
}
