// Edits of the text: written, tried, or only planned.
import { $, seconds } from "./dom.js";
import { post } from "./server.js";

// Maximum time for which a trial waits for the preview of the one before, in milliseconds.
const PATIENCE = 800;

// `page` gives the graph (`view`), `attempt`, `notify` and `refresh`. `marked` is called with the nodes that an edit would
// run, and `refused` after an edit was refused.
export function Edits(page, marked, refused) {
  // Digest of the text that an edit of the page has written, until the page has fetched the graph of this text.
  let written = null;
  const seen = () => written ?? page.view.digest;

  // Sends a request that edits the text, after the ones before it. An edit is made of the text that the page shows when
  // the user makes it, or of the text that the edit before it wrote.
  let queue = Promise.resolve();
  let queued = 0;
  function change(path, data) {
    const digest = queued ? null : seen();
    queued += 1;
    const sent = queue.then(() => send(path, data, digest)).finally(() => { queued -= 1; });
    queue = sent.catch(() => {});
    return sent;
  }

  async function send(path, data, digest) {
    try {
      const answer = await post(path, { ...data, digest: digest ?? seen() });
      written = answer.digest ?? written;
      page.notify(null);
      return answer;
    } catch (error) {
      if (error.body?.code === "stale") { written = null; page.refresh(); }
      throw error;
    }
  }

  let waiting = null;
  let trying = null;
  // True from the first trial of a value until it is written or dropped.
  let dragging = false;

  // Writes an edit; gives null if it was refused.
  const set = (edit) => page.attempt(async () => {
    // A trial or a plan that is still on its way must not come after the edit.
    [trying, dragging] = [null, false];
    seenPreview();
    clearTimeout(waiting);
    waiting = null;
    await change("/set", edit);
    plan(null);
    return true;
  }).then((done) => {
    if (done === null) { post("/try", null).catch(() => {}); refused(); }
    return done;
  });

  // Tries an edit. A new trial stops the run of the one before. So the next trial waits until this one has been seen as
  // a preview, but not longer than `PATIENCE`; of the trials that wait, the last one is used.
  let trials = false;
  let seenPreview = () => {};
  function tryOut(edit) {
    [trying, dragging] = [{ digest: seen(), ...edit }, true];
    if (!trials) run();
  }

  async function run() {
    trials = true;
    while (trying) {
      const next = trying;
      const preview = new Promise((go) => { seenPreview = go; });
      try {
        await post("/try", next);
        await Promise.race([preview, new Promise((go) => { setTimeout(go, PATIENCE); })]);
      } catch (error) {
        // A trial that an edit has overtaken may find another text.
        if (trying === next) page.notify(error.message);
      }
      if (trying === next) trying = null;
    }
    trials = false;
  }

  function revert() {
    [trying, dragging] = [null, false];
    seenPreview();
    plan(null);
    page.attempt(() => post("/try", null));
  }

  // Shows what an edit would run, before it is made, when the user has stopped typing. `null` removes that.
  function plan(edit) {
    clearTimeout(waiting);
    const own = setTimeout(async () => {
      let [nodes, words] = [[], ""];
      try {
        const found = edit && await post("/plan", { digest: seen(), ...edit });
        if (found) {
          nodes = found.nodes;
          words = nodes.length ? `would run ${nodes.join(", ")}${found.forecast.seconds ? `; about ${seconds(found.forecast.seconds)}` : ""}` : "would run nothing";
        }
      } catch (error) {
        words = error.message;
      }
      if (waiting !== own) return;
      marked(nodes);
      for (const id of ["plan", "place-plan"]) if ($(id)) $(id).textContent = words;
    }, edit ? 200 : 0);
    waiting = own;
  }

  // The edits of one parameter of a node, for its editor.
  function of(node, param) {
    const whole = (value, at) => ({ digest: seen(), node: node.in_file, field: param.name, at, value });
    return {
      set: (value, at) => set(whole(value, at)),
      attempt: (value, at) => tryOut(whole(value, at)),
      revert,
      plan: (value, at) => plan(whole(value, at)),
      unplan: () => plan(null),
    };
  }

  return {
    change, set, attempt: tryOut, revert, of, seen, plan,
    drags: () => dragging,
    // A run or a preview has ended.
    previewed: () => seenPreview(),
    // The page has fetched the graph of a text.
    fetched: (digest) => { if (digest === written) written = null; },
  };
}
