// The connection to the dashboard's server: what it tells, and requests for a change.

const AGAIN_AFTER = 1000;  // [ms]
const KEY = "fopid-dashboard-token";

// The token comes behind the #, which browsers keep to themselves, and does not stay in the address.
function rememberToken() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    sessionStorage.setItem(KEY, token);
    history.replaceState(null, "", location.pathname);
  }
}

// Ask for a change. Resolves to { status, message }; status 0 without an answer.
export async function ask(what, fields = {}) {
  try {
    const answer = await fetch(`api/${what}`, {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${sessionStorage.getItem(KEY) || ""}` },
      body: JSON.stringify(fields),
    });
    return { status: answer.status, message: (await answer.json()).message };
  } catch {
    return { status: 0, message: "the dashboard's server does not answer" };
  }
}

// "may change", or why not. Without a token the server is not asked: browsers log each refusal.
async function mayChange() {
  if (!sessionStorage.getItem(KEY)) return false;
  const { status } = await ask("token");
  if (status === 401) sessionStorage.removeItem(KEY);
  return status === 200;
}

// Connect, and again whenever the connection is lost.
export function connect({ onMessage, onOpen, onLost }) {
  rememberToken();
  addEventListener("hashchange", async () => {
    rememberToken();
    onOpen(await mayChange());
  });
  const open = () => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.onopen = async () => onOpen(await mayChange());
    socket.onmessage = (event) => onMessage(JSON.parse(event.data));
    socket.onclose = () => {
      onLost();
      setTimeout(open, AGAIN_AFTER);
    };
  };
  open();
}
