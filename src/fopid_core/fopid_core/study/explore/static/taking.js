// The gains as YAML, Python and C, and the report of the process.

const at = (id) => document.getElementById(id);
const FILES = { yaml: "fopid_controller.yaml", python: "fopid_loop.py", c: "fopid_controller.h" };
const SOON = 250;  // [ms] after the last move

function save(name, text, type = "text/plain") {
  const link = Object.assign(document.createElement("a"), { download: name, href: URL.createObjectURL(new Blob([text], { type })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

export function startTaking({ ask, state }) {
  let kind = "yaml", waiting = 0;

  function say(text, good = true) {
    at("take-answer").textContent = text;
    at("take-answer").className = `answer ${good ? "good" : "bad"}`;
  }

  async function fetchCode() {
    const answer = await ask("take", { process: state.process, gains: state.gains, kind });
    at("code").textContent = answer.status === 200 ? answer.text : "";
    say(answer.status === 200 ? "" : answer.message, answer.status === 200);
  }

  for (const button of document.querySelectorAll("[data-take]")) {
    button.addEventListener("click", () => {
      kind = button.dataset.take;
      for (const other of document.querySelectorAll("[data-take]")) other.setAttribute("aria-pressed", String(other === button));
      fetchCode();
    });
  }
  at("copy").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(at("code").textContent);
      say("copied");
    } catch {
      say("the browser does not allow copying; select the text", false);
    }
  });
  at("save").addEventListener("click", () => save(FILES[kind], at("code").textContent));
  at("report").addEventListener("click", async () => {
    at("report").disabled = true;
    say("writing the report");
    const answer = await ask("report", { process: state.process, gains: state.gains });
    at("report").disabled = false;
    say(answer.status === 200 ? "" : answer.message, answer.status === 200);
    if (answer.status === 200) save("design.html", answer.text, "text/html");
  });
  return {
    show() {
      clearTimeout(waiting);
      waiting = setTimeout(fetchCode, SOON);
    },
  };
}
