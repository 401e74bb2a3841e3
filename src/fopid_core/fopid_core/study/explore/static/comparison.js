// Every method and structure on the process, as `fopid compare` has it; a row can be put on the sliders.

const at = (id) => document.getElementById(id);
const COLUMNS = [
  ["iae_setpoint", "IAE setpoint"], ["iae_load", "IAE load"], ["ms", "Ms"], ["mt", "Mt"], ["overshoot_pct", "overshoot %"],
  ["settling_time", "settles s"], ["control_peak", "control peak"], ["noise_gain", "noise gain"], ["delay_margin", "delay margin s"],
];

function cell(tag, textContent, more = {}) {
  return Object.assign(document.createElement(tag), { textContent, ...more });
}

export function startComparison({ ask, take, state }) {
  const box = at("comparison").parentElement;

  function line(row, taken) {
    const made = document.createElement("tr"), name = cell("th", `${taken ? "★ " : ""}${row.method}`, { scope: "row", className: "words" });
    made.className = taken ? "taken" : row.within ? "" : "broken";
    if (row.unmet.length) made.title = row.unmet.join("; ");
    made.append(name, cell("td", row.structure ?? "–", { className: "words" }));
    if (!row.gains) {
      made.append(cell("td", row.reason, { colSpan: COLUMNS.length + 1, className: "words" }));
      return made;
    }
    made.append(...COLUMNS.map(([key]) => cell("td", row[key] === null ? "–" : Number(row[key].toPrecision(3)).toString())));
    const button = cell("button", "Take", { type: "button" });
    button.setAttribute("aria-label", `Take ${row.method}, ${row.structure}`);
    button.addEventListener("click", () => {
      const { filter, setpoint_weights: weights } = row;
      take({
        ...row.gains, ...(filter.order && filter.time ? { filter_order: filter.order, filter_time: filter.time } : {}),
        setpoint_weight: weights.proportional, derivative_setpoint_weight: weights.derivative,
      }, { sliders: true });
      at("prediction").scrollIntoView({ block: "start" });
    });
    const last = cell("td", "");
    last.append(button);
    made.append(last);
    return made;
  }

  at("compare").addEventListener("click", async () => {
    const process = state.process;
    at("compare").disabled = true;
    at("compare-progress").hidden = false;
    at("compare-answer").textContent = "";
    const answer = await ask("compare", { process });
    at("compare").disabled = false;
    at("compare-progress").hidden = true;
    if (process !== state.process) return;
    at("compare-answer").className = `answer ${answer.status === 200 ? "" : "bad"}`;
    at("compare-answer").textContent = answer.status === 200 ? answer.reason : answer.message;
    if (answer.status !== 200) return;
    const head = document.createElement("tr");
    head.append(...["method", "structure"].map((name) => cell("th", name, { scope: "col", className: "words" })),
      ...COLUMNS.map(([, name]) => cell("th", name, { scope: "col" })), cell("td", ""));
    at("comparison").replaceChildren(head, ...answer.rows.map((row, i) => line(row, i === answer.recommended?.row)));
    box.hidden = false;
  });

  return {
    forget() {
      box.hidden = true;
      at("compare-answer").textContent = "";
    },
  };
}
