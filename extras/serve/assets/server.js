// Requests to the server, and its stream of events.

export class Refused extends Error {
  constructor(status, body) {
    super(body.why ?? reason(body));
    this.status = status;
    this.body = body;
  }
}

// The message when there was no answer; the page removes it when the connection is back.
export const LOST = "The program did not answer. If `lightharmony watch --serve` was stopped, start it again; the page then goes on.";

function reason(body) {
  switch (body.code) {
    case "lost": return LOST;
    case "stale": return "Another program saved the graph in the meantime. Nothing was overwritten; the page now shows the new text.";
    case "confined": return "This graph belongs to an unpacked bundle, whose files are never written. Copy it into a folder of your own to edit it.";
    case "nothing": return "There is nothing to undo or redo.";
    case "invalid": return body.mistakes.map((one) => [one.message, one.label, ...(one.hints ?? [])].filter(Boolean).join("; ")).join("\n");
    default: return `The server refused the request (${body.code ?? "without a reason"}).`;
  }
}

async function asked(path, init) {
  let response;
  try { response = await fetch(path, init); } catch { throw new Refused(0, { code: "lost" }); }
  if (response.ok) return response;
  let body = {};
  try { body = await response.json(); } catch { /* no reason was given */ }
  throw new Refused(response.status, body);
}

export async function post(path, data) {
  const headers = { "Content-Type": "application/json", "X-Lightharmony": "1" };
  return (await asked(path, { method: "POST", headers, body: JSON.stringify(data) })).json();
}

export const json = async (path) => (await asked(path)).json();
export const bytes = async (path) => (await asked(path)).arrayBuffer();

// Exchanges the token in the fragment for a cookie, and removes it from the address.
export async function enter() {
  const token = location.hash.slice(1);
  if (!token) return;
  history.replaceState(null, "", location.pathname);
  await post("/session", { token });
}

// Calls `handle(event)` for each event, and `state(connected)` when the connection begins and ends. The browser
// reconnects by itself; the first event is then the whole state.
export function listen(handle, state) {
  const source = new EventSource("/events");
  source.onopen = () => state(true);
  source.onmessage = (message) => handle(JSON.parse(message.data));
  source.onerror = () => {
    state(false);
    // A refusal ends the source; a lost connection does not.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(handle, state), 1000);
  };
}
