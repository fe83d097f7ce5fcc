// The keys of the page.
import { $, el, show } from "./dom.js";

// `act` has an action for each key; `place` is asked first while the place view has the focus.
export function Keys(act, place) {
  const KEYS = [
    ["arrows", "move between nodes of the graph", null],
    ["f", "flip between A and B", () => act.flip()],
    ["s", "A and B side by side with a slider", () => act.mode(1)],
    ["d", "difference of A and B", () => act.mode(3)],
    ["l", "FLIP: the difference that a viewer sees", () => act.mode(4)],
    ["[ ]", "less or more exposure", null],
    ["0", "fit the picture into the pane", () => act.fit()],
    ["1", "one picture pixel per screen pixel", () => act.whole()],
    ["b", "look around in a panorama", () => act.round()],
    ["+ -", "zoom", null],
    ["arrows", "in the picture: pan, or turn the panorama; on the slider between A and B: move it", null],
    ["p", "picture or place", () => act.pane($("place").hidden ? "place" : "picture")],
    ["r", "trade: time against error, presets", () => act.pane($("trade").hidden ? "trade" : "picture")],
    ["t", "text or nodes", () => act.text()],
    ["Ctrl+Z", "undo the last change of the text", null],
    ["Ctrl+Shift+Z", "redo", null],
    ["Escape", "while a value is edited: back to the text", null],
    ["?", "this list", () => $("keys").showModal()],
    ["W A S D Q E", "in the place: fly", null],
    ["arrows, page up and down", "in the place: move the object by 1 cm, with Shift by 10 cm", null],
    [", .", "in the place: turn the object by 5 degrees", null],
    ["< >", "in the place: make the object smaller or larger by 5 %", null],
    ["j l i k", "in the place: turn the view", null],
    ["g", "in the place: put the object on the ground below it", null],
    ["x", "in the place: click where the object shall stand; arrows and Enter click", null],
    ["m", "in the place: measure a distance, and set the scale by it", null],
    ["n", "in the place: the next object", null],
    ["c", "in the place: look through the next camera", null],
    ["Enter", "in the place: set the camera to this view", null],
    ["0 f", "in the place: see all of it, or the object", null],
    ["o", "in the place: the traced picture over the view of its camera", null],
  ];
  const more = { "[": () => act.exposure(-0.5), "]": () => act.exposure(0.5), "+": () => act.zoom(1.5), "=": () => act.zoom(1.5), "-": () => act.zoom(1 / 1.5) };

  document.addEventListener("keydown", (event) => {
    const { target } = event;
    const typing = target.matches?.('input[type="text"], textarea, select:not(#other, #mode), dialog *');
    // In a field that was typed into, Ctrl+Z takes back the typing.
    const typed = typing && target.value !== target.defaultValue;
    if ((event.ctrlKey || event.metaKey) && ["z", "y"].includes(event.key.toLowerCase()) && !typed) {
      event.preventDefault();
      act.step(event.shiftKey || event.key.toLowerCase() === "y" ? "/redo" : "/undo");
      return;
    }
    if (typing || event.ctrlKey || event.metaKey || event.altKey || target.matches?.('input[type="range"]') && !"?fsdlrt".includes(event.key)) return;
    const onControl = target.matches?.('#place button, #place input[type="checkbox"]') && !["Enter", " "].includes(event.key);
    const inPlace = !$("place").hidden && (target === document.body || target === $("space") || onControl);
    if (inPlace && place()?.key(event)) { event.preventDefault(); return; }
    const action = more[event.key] ?? KEYS.find(([key]) => key === event.key)?.[2];
    if (action) { event.preventDefault(); action(); }
  });

  show($("key-list"), KEYS.map(([key, what]) => [el("dt", {}, key), el("dd", {}, what)]).flat());
  $("help").addEventListener("click", () => $("keys").showModal());
}
