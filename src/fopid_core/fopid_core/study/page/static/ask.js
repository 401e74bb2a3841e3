// Requests to the page's own server, and the token they show.

const KEY = "fopid-page-token";

// The token comes behind the #, which browsers keep to themselves, and does not stay in the address.
export function rememberToken() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    sessionStorage.setItem(KEY, token);
    history.replaceState(null, "", location.pathname);
  }
}

// Ask the server for something. Resolves to { status, ... } with what it answers, { status, message } when it does not.
export async function ask(what, fields = {}) {
  try {
    const answer = await fetch(`api/${what}`, {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${sessionStorage.getItem(KEY) || ""}` },
      body: JSON.stringify(fields),
    });
    return { ...(await answer.json()), status: answer.status };
  } catch {
    return { status: 0, message: "the page's server does not answer" };
  }
}

// "may change", or why not. Without a token the server is not asked: browsers log each refusal.
export async function mayChange() {
  if (!sessionStorage.getItem(KEY)) return false;
  const { status } = await ask("token");
  if (status === 401) sessionStorage.removeItem(KEY);
  return status === 200;
}
