// The text of the graph, with the mistakes at their places.
import { $, el, show } from "./dom.js";

export function Text() {
  const place = $("text");
  let shown = "";

  function draw(view, line) {
    const signature = JSON.stringify([view.digest, view.mistakes, line]);
    if (signature === shown) return;
    shown = signature;
    if (view.text === null || view.text === undefined) return show(place, "The text is too long to show here.");
    // The names of files in mistakes are paths as the command line has them.
    const own = view.mistakes.filter((one) => one.file === (view.name ?? one.file));
    const rows = view.text.replace(/^\ufeff/, "").split("\n").map((text, at) => {
      const here = own.filter((one) => one.line === at + 1);
      const row = el("div", { class: `row${at + 1 === line ? " chosen" : ""}` },
        el("span", { class: "number" }, String(at + 1)), el("span", {}, marked(text.replace(/\r$/, ""), here)));
      const why = here.map((one) => el("div", { class: "why" }, [one.message, one.label, ...(one.hints ?? [])].filter(Boolean).join("\n")));
      return [row, ...why];
    });
    show(place, rows.flat());
  }

  function marked(text, mistakes) {
    const letters = Array.from(text);
    const parts = [];
    let at = 0;
    for (const one of [...mistakes].sort((a, b) => a.column - b.column)) {
      const start = Math.max(at, one.column - 1);
      const end = Math.min(letters.length, start + Math.max(1, one.length));
      parts.push(letters.slice(at, start).join(""), el("mark", {}, letters.slice(start, end).join("") || " "));
      at = Math.max(end, at);
    }
    parts.push(letters.slice(at).join(""));
    return parts;
  }

  function scroll(line) {
    place.querySelectorAll(".row")[line - 1]?.scrollIntoView({ block: "center" });
  }

  return { draw, scroll };
}
