// What would happen: responses, Bode, Nyquist, verdict and measures of some sets of gains, as they are asked for.
//
// createPrediction(element, predict) builds itself into the element; predict(fields) resolves to what the server's
// `prediction.answer` gives, with `status`. show({ process, sets, horizon, sampleTime }) draws; a set is
// { label, kind, gains }, its kind one of STYLES.

import { BLUE, GREEN, GREY, RED, VIOLET } from "./chart.js";
import { curveChart } from "./curves.js";
import { measuresTable } from "./measures.js";
import { nyquistChart } from "./nyquist.js";

const REST = 150;  // [ms] after which a hand rests
const MOST_KNOWN = 50;  // sets whose answers are kept
export const STYLES = {
  baseline: { stroke: GREY, dash: [6, 4] }, new: { stroke: BLUE },
  pi: { stroke: GREEN }, pid: { stroke: RED }, fopid: { stroke: VIOLET },
};
const BADGES = { stable: "Stable", unstable: "Unstable", undecided: "Not decided" };

const SKELETON = `
  <div class="verdict"><b class="badge" role="status"></b><span class="why quiet"></span></div>
  <ul class="sets" aria-label="Curves"></ul>
  <div class="charts">
    <figure data-chart="setpoint" class="first"></figure><figure data-chart="load"></figure>
    <figure data-chart="control"></figure><figure data-chart="nyquist"></figure>
    <figure data-chart="gain"></figure><figure data-chart="phase"></figure>
  </div>
  <p class="answer bad trouble" role="status"></p>
  <div class="scroll" tabindex="0" role="region" aria-label="Measures"><table class="measures"></table></div>`;

export function createPrediction(root, predict) {
  root.classList.add("prediction");
  root.innerHTML = SKELETON;
  const part = (selector) => root.querySelector(selector), figure = (name) => part(`[data-chart="${name}"]`);
  const time = { unit: "s", key: "prediction-time" }, frequency = { unit: "rad/s", log: true, key: "prediction-frequency" };
  const charts = {
    setpoint: curveChart(figure("setpoint"), { title: "Setpoint step, output", levels: [1], ...time }),
    load: curveChart(figure("load"), { title: "Load step, output", levels: [0], ...time }),
    control: curveChart(figure("control"), { title: "Setpoint step, control", ...time }),
    gain: curveChart(figure("gain"), { title: "Open loop, gain [dB]", levels: [0], ...frequency }),
    phase: curveChart(figure("phase"), { title: "Open loop, phase [°]", levels: [-180], floor: -540, ...frequency }),
  };
  const nyquist = nyquistChart(figure("nyquist"));
  let wanted = null, busy = false, version = 0, resting = 0, last = null;
  const known = { about: "", seen: new Map(), scales: {} };

  function draw({ sets, begun }, answer) {
    const all = sets.map((set, i) => ({ ...STYLES[set.kind], label: set.label, seen: answer.sets[i] }));
    // The newest lies on top, and what is no number at all is left out.
    const curves = (values, peak = () => null) => all.filter(({ seen }) => values(seen)).map(({ seen, label, stroke, dash }) => ({
      label, stroke, dash, values: values(seen), peak: peak(seen), calm: seen.verdict.badge !== "unstable",
    }));
    charts.setpoint.draw(answer.time, curves((seen) => seen.setpoint.output));
    charts.load.draw(answer.time, curves((seen) => seen.load.output));
    charts.control.draw(answer.time, curves((seen) => seen.setpoint.control, (seen) => seen.measures.control_peak.value));
    charts.gain.draw(answer.frequency, curves((seen) => seen.bode.gain_db));
    charts.phase.draw(answer.frequency, curves((seen) => seen.bode.phase_deg));
    nyquist.draw(all.map(({ seen, ...style }) => ({ ...style, ...seen.nyquist, ms: seen.margins.ms.value })));
    showVerdict(all.at(-1).seen);
    part(".sets").replaceChildren(...all.map(legend));
    measuresTable(part(".measures"), all);
    const silent = all.find(({ seen }) => seen.setpoint.reason || seen.load.reason);
    part(".trouble").textContent = silent ? `${silent.label}: ${silent.seen.setpoint.reason || silent.seen.load.reason}` : "";
    if (begun) {
      requestAnimationFrame(() => setTimeout(() => {
        performance.measure("hand to picture", { start: begun, end: performance.now() });
      }));
    }
  }

  function legend({ label, stroke, dash, seen }) {
    const item = document.createElement("li");
    item.innerHTML = `<svg width="26" height="8" aria-hidden="true"><line x1="0" x2="26" y1="4" y2="4" stroke-width="3"/></svg>`;
    const line = item.querySelector("line");
    line.setAttribute("stroke", stroke);
    if (dash) line.setAttribute("stroke-dasharray", dash.join(" "));
    item.append(label);
    if (seen.verdict.badge !== "stable") item.append(Object.assign(document.createElement("em"), { textContent: ` ${BADGES[seen.verdict.badge].toLowerCase()}` }));
    return item;
  }

  function showVerdict({ verdict, exact }) {
    const badge = part(".badge");
    badge.className = `badge ${verdict.badge}`;
    if (badge.textContent !== BADGES[verdict.badge]) badge.textContent = BADGES[verdict.badge];
    const how = exact ? "" : "; curves to about 1 %, exact when the hand rests";
    part(".why").textContent = (verdict.badge === "stable" ? "by the argument principle on the process itself" : verdict.reason) + how;
  }

  // What the server said of a set before is not asked for again: the baseline costs nothing while the hand moves.
  async function one({ process, sets, horizon, sampleTime }, quick) {
    const more = {
      ...(process === undefined ? {} : { process }), ...(horizon ? { horizon } : {}),
      ...(sampleTime ? { sample_time: sampleTime } : {}),
    };
    const about = JSON.stringify(more), keys = sets.map(({ gains }) => JSON.stringify(gains));
    if (known.about !== about || process === undefined || !horizon) Object.assign(known, { about, seen: new Map() });
    const missing = keys.filter((key, i) => {
      const seen = known.seen.get(key);
      return keys.indexOf(key) === i && !(seen && (quick || seen.exact));
    });
    if (missing.length === 0) return { status: 200, ...known.scales, sets: keys.map((key) => known.seen.get(key)) };
    const answer = await predict({ ...more, quick, sets: missing.map((key) => JSON.parse(key)) });
    if (answer.status !== 200) return answer;
    const { time, frequency } = answer;
    if (known.seen.size > MOST_KNOWN) known.seen = new Map([...known.seen].filter(([key]) => keys.includes(key)));
    missing.forEach((key, i) => known.seen.set(key, answer.sets[i]));
    known.scales = { time, frequency };
    return { ...answer, sets: keys.map((key) => known.seen.get(key)) };
  }

  // One request at a time, always for the newest gains: what lies between was passed over by the hand.
  async function pump() {
    if (busy) return;
    busy = true;
    while (wanted) {
      const job = wanted;
      wanted = null;
      const answer = await one(job, true);
      if (answer.status === 200) {
        last = { job, answer };
        draw(job, answer);
      } else {
        part(".trouble").textContent = answer.message;
      }
    }
    busy = false;
    if (last && last.answer.sets.some(({ exact }) => !exact)) {
      clearTimeout(resting);
      resting = setTimeout(refine, REST, version);
    }
  }

  async function refine(asked) {
    const answer = asked === version && await one(last.job, false);
    if (!answer || asked !== version || answer.status !== 200) return;
    last = { job: last.job, answer };
    draw({ ...last.job, begun: null }, answer);
  }

  return {
    show(job) {
      version++;
      wanted = job;
      pump();
    },
    get answer() {
      return last?.answer ?? null;
    },
  };
}
