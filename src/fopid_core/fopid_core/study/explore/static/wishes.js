// Two sliders instead of five numbers: how robust and how fast; the best PI, PID and FOPID for them side by side.

const at = (id) => document.getElementById(id);
const LABELS = { pi: "PI", pid: "PID", fopid: "FOPID" };
const REST = 300;  // [ms] after which the front is drawn anew

function short(value, digits = 3) {
  return value === null || value === undefined ? "–" : Number(value.toPrecision(digits)).toString();
}

export function startWishes({ ask, take, front, state }) {
  let chosen = "pid", wanted = false, busy = false, resting = 0, designs = [], moved = false;

  const msMax = () => {
    const [low, high] = state.about.ms_range;
    return low * (high / low) ** (at("robustness").value / 100);
  };
  const effort = () => {
    const [low, high] = state.about.effort_range;
    return low * (high / low) ** (at("speed").value / 100);
  };

  function showWishes() {
    at("robustness-text").textContent = `max |S| up to ${msMax().toFixed(2)}`;
    at("speed-text").textContent = `control up to ${short(effort() * state.about.effort_unit)}`;
    at("robustness").setAttribute("aria-valuetext", `max S up to ${msMax().toFixed(2)}`);
    at("speed").setAttribute("aria-valuetext", `control up to ${short(effort() * state.about.effort_unit)}`);
  }

  async function follow() {
    showWishes();
    wanted = true;
    if (busy) return;
    busy = true;
    at("structures").setAttribute("aria-busy", "true");
    while (wanted) {
      wanted = false;
      const process = state.process;
      const answer = await ask("designs", { process, ms_max: msMax(), effort: effort() });
      if (answer.status !== 200) {
        at("wishes-answer").textContent = answer.message;
        at("wishes-answer").className = "answer bad";
        continue;
      }
      if (process !== state.process) continue;
      at("wishes-answer").textContent = "";
      designs = answer.designs;
      await showStructures();
      if (moved) takeChosen();
    }
    busy = false;
    at("structures").setAttribute("aria-busy", "false");
    clearTimeout(resting);
    resting = setTimeout(drawFront, REST);
  }

  async function drawFront() {
    const process = state.process, answer = await ask("fronts", { process, effort: effort() });
    if (answer.status === 200 && process === state.process) front.draw(answer.fronts, state.gains);
  }

  function takeChosen() {
    const design = designs.find(({ structure }) => structure === chosen);
    const others = designs.filter(({ structure, gains, met }) => structure !== chosen && gains && met)
      .map(({ structure, gains }) => ({ label: LABELS[structure], kind: structure, gains }));
    if (design?.gains) take(design.gains, { sliders: true, others, name: LABELS[chosen], begun: performance.now() });
  }

  async function showStructures() {
    const there = designs.filter(({ gains }) => gains);
    const answer = await ask("predict", {
      process: state.process, quick: true, ...(state.horizon ? { horizon: state.horizon } : {}),
      sets: there.map(({ gains }) => gains),
    });
    if (answer.status !== 200 || there.length === 0) return;
    const head = row("tr", ["th", ""], ["th", "settles"], ["th", "over"], ["th", "effort"], ["th", "Ms"], ["th", "IAE"]);
    const rows = designs.map((design) => {
      const seen = answer.sets[there.indexOf(design)];
      if (!seen) return row("tr", ["td", LABELS[design.structure]], ["td", "none found"]);
      const { settling_time, overshoot_pct, control_peak } = seen.measures;
      const line = row("tr", ["td", ""], ["td", `${short(settling_time.value)} s`], ["td", `${short(overshoot_pct.value, 2)} %`],
        ["td", short(control_peak.value)], ["td", short(seen.margins.ms.value)], ["td", short(design.cost)]);
      line.firstChild.append(button(design));
      if (!design.met) line.title = "no controller of this structure keeps both wishes";
      line.classList.toggle("broken", !design.met);
      return line;
    });
    const focused = document.activeElement?.dataset?.structure;
    at("structures").replaceChildren(head, ...rows);
    if (focused) at("structures").querySelector(`[data-structure="${focused}"]`)?.focus();
  }

  function row(tag, ...cells) {
    const line = document.createElement(tag);
    line.append(...cells.map(([kind, textContent]) => Object.assign(document.createElement(kind), { textContent })));
    return line;
  }

  function button({ structure }) {
    const made = Object.assign(document.createElement("button"), { type: "button", textContent: LABELS[structure] });
    made.dataset.structure = structure;
    made.setAttribute("aria-pressed", String(structure === chosen && moved));
    made.addEventListener("click", () => {
      chosen = structure;
      moved = true;
      for (const other of at("structures").querySelectorAll("button")) {
        other.setAttribute("aria-pressed", String(other.dataset.structure === chosen));
      }
      takeChosen();
    });
    return made;
  }

  function match() {
    const [low, high] = state.about.effort_range;
    ask("predict", { process: state.process, sets: [state.baseline] }).then((answer) => {
      const peak = answer.status === 200 ? answer.sets[0].measures.control_peak.value : null;
      if (peak === null) {
        at("wishes-answer").textContent = "The baseline's control effort is not known.";
        at("wishes-answer").className = "answer bad";
        return;
      }
      const share = Math.log(peak / state.about.effort_unit / low) / Math.log(high / low);
      at("speed").value = Math.round(100 * Math.min(Math.max(share, 0), 1));
      moved = true;
      follow();
    });
  }

  for (const id of ["robustness", "speed"]) {
    at(id).addEventListener("input", () => {
      moved = true;
      follow();
    });
  }
  at("match").addEventListener("click", match);
  return {
    begin() {
      moved = false;
      follow();
    },
  };
}
