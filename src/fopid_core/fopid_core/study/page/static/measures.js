// A table of what is measured of each set, side by side.

const ROWS = [
  ["margins", "ms", "Ms, largest |S|", (v) => v.toFixed(3)],
  ["margins", "mt", "Mt, largest |T|", (v) => v.toFixed(3)],
  ["margins", "phase_margin_deg", "phase margin", (v) => `${v.toFixed(1)}°`],
  ["margins", "gain_margin", "gain margin", (v) => `${(20 * Math.log10(v)).toFixed(1)} dB`],
  ["margins", "delay_margin", "delay margin", (v) => `${short(v)} s`],
  ["margins", "crossover", "crossover", (v) => `${short(v)} rad/s`],
  ["measures", "overshoot_pct", "overshoot", (v) => `${v.toFixed(1)} %`],
  ["measures", "settling_time", "settles (2 %)", (v) => `${short(v)} s`],
  ["measures", "rise_time", "rises (10–90 %)", (v) => `${short(v)} s`],
  ["measures", "control_peak", "control peak", (v) => short(v)],
];

function short(value) {
  return Number(value.toPrecision(3)).toString();
}

function make(tag, text, more = {}) {
  return Object.assign(document.createElement(tag), { textContent: text, ...more });
}

function cell({ value, reason }, text) {
  if (value !== null) return make("td", text(value));
  return make("td", /^infinite(:|$)/.test(reason) ? "∞" : "–", { title: reason });
}

export function measuresTable(table, sets) {
  const head = document.createElement("tr");
  head.append(make("td", ""), ...sets.map(({ label, stroke }) => {
    const name = make("th", label, { scope: "col" });
    name.style.boxShadow = `inset 0 -3px ${stroke}`;
    return name;
  }));
  const rows = ROWS.map(([group, name, label, text]) => {
    const row = document.createElement("tr");
    row.append(make("th", label, { scope: "row" }), ...sets.map(({ seen }) => cell(seen[group][name], text)));
    return row;
  });
  table.replaceChildren(head, ...rows);
}
