// A slider and a field for each of the five numbers.
//
// A gain's slider begins at exactly 0 and goes on by decades, as far as the process says. Its sign is changed by the
// button and in the field, never by moving.

export const GAINS = ["kp", "ki", "kd", "lam", "mu"];
const NAMES = {
  kp: "proportional gain", ki: "integral gain", kd: "derivative gain",
  lam: "order of the integral", mu: "order of the derivative",
};
const ORDERS = new Set(["lam", "mu"]), LARGEST_ORDER = 2;
const STEPS = 1000, DECADES = 3;

export function text(value) {
  return Number(value.toPrecision(4)).toString();
}

// createSliders(element, onInput): set(gains), values(), setRanges({ kp, ki, kd }).
export function createSliders(root, onInput) {
  const parts = {}, now = { kp: 0, ki: 0, kd: 0, lam: 1, mu: 1 }, ends = { kp: 20, ki: 20, kd: 20 }, sign = { kp: 1, ki: 1, kd: 1 };

  function place(name) {
    if (ORDERS.has(name)) return (now[name] / LARGEST_ORDER) * STEPS;
    const size = Math.abs(now[name]);
    if (size === 0) return 0;
    return Math.max(1, Math.round((1 + Math.log10(size / ends[name]) / DECADES) * STEPS));
  }

  function value(name, at) {
    if (ORDERS.has(name)) return Math.round((at / STEPS) * LARGEST_ORDER * 1000) / 1000;
    return at === 0 ? 0 : sign[name] * Number(text(ends[name] * 10 ** ((at / STEPS - 1) * DECADES)));
  }

  function show(name, field = true) {
    const { slider, number, turn } = parts[name];
    if (Math.abs(now[name]) > ends[name]) ends[name] = 2 * Math.abs(now[name]);
    slider.value = place(name);
    slider.setAttribute("aria-valuetext", text(now[name]));
    if (field) number.value = text(now[name]);
    if (turn) {
      turn.textContent = sign[name] < 0 ? "−" : "+";
      turn.setAttribute("aria-pressed", String(sign[name] < 0));
    }
  }

  function change(name, to, field) {
    now[name] = to;
    if (to !== 0 && name in sign) sign[name] = Math.sign(to);
    show(name, field);
    onInput({ ...now });
  }

  function row(name) {
    const box = document.createElement("div"), order = ORDERS.has(name);
    box.className = "five";
    box.innerHTML = `<label for="${name}-value" title="${NAMES[name]}">${name}</label>
      ${order ? "<span></span>" : `<button type="button" class="sign" aria-label="${name} negative" aria-pressed="false">+</button>`}
      <input id="${name}" type="range" min="0" max="${STEPS}" aria-label="${name}, ${NAMES[name]}">
      <input id="${name}-value" type="number" step="any"${order ? ` min="0" max="${LARGEST_ORDER}"` : ""}>`;
    const [slider, number] = box.querySelectorAll("input"), turn = box.querySelector(".sign");
    parts[name] = { slider, number, turn };
    slider.addEventListener("input", () => change(name, value(name, Number(slider.value))));
    number.addEventListener("input", () => {
      const typed = number.valueAsNumber;
      const good = Number.isFinite(typed) && (!order || (typed >= 0 && typed <= LARGEST_ORDER));
      number.setAttribute("aria-invalid", String(!good));
      if (good) change(name, typed, false);
    });
    turn?.addEventListener("click", () => {
      sign[name] = -sign[name];
      change(name, now[name] ? -now[name] : 0);
    });
    return box;
  }

  root.replaceChildren(...GAINS.map(row));
  GAINS.forEach((name) => show(name));
  return {
    set(gains) {
      for (const name of GAINS) {
        now[name] = gains[name] ?? now[name];
        if (now[name] && name in sign) sign[name] = Math.sign(now[name]);
        parts[name].number.removeAttribute("aria-invalid");
        show(name);
      }
    },
    setRanges(ranges, of = 1) {
      for (const name of Object.keys(ends)) {
        ends[name] = ranges[name];
        if (!now[name]) sign[name] = of;
      }
      GAINS.forEach((name) => show(name));
    },
    values: () => ({ ...now }),
  };
}
