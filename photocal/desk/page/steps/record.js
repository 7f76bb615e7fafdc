// Step Record: the monitor's own page in the window, or what begins a recording.

import { fill, h, said } from "../dom.js";

const AGAIN_MS = 3000;

export async function mount(element, context) {
  const { say } = context;
  const box = h("section");
  element.append(box);
  let timer = 0;
  let shown = "";

  async function look() {
    clearTimeout(timer);
    try {
      const state = await context.get("/api/record");
      draw(state);
      if (!state.file) timer = setTimeout(look, AGAIN_MS);
    } catch (failure) {
      fill(box, said("bad", failure.message));
    }
  }

  function draw(state) {
    context.command(state.file ? state.line : state.begin[1] ?? "acquire record flight.toml");
    const key = JSON.stringify(state);
    if (key === shown) return;
    shown = key;
    element.classList.toggle("filled", Boolean(state.file));
    if (state.file) {
      fill(box, h("h1.unseen", {}, say("record.title")), h("iframe.monitor", { src: "/monitor/", title: say("record.monitor"), allow: "autoplay" }));
      return;
    }
    fill(box, h("h1", {}, say("record.title")), h("p.lead", {}, say("record.none")),
      state.calibration.map(([line, good]) => said(good ? "good" : "warn", line)),
      h("div.card", {}, h("h2", {}, say("record.begin")),
        state.begin.length ? h("ol", {}, state.begin.map((line) => h("li", {}, h("code", {}, line)))) : h("p", {}, say("record.no-configuration")),
        h("p.hint", {}, say("record.appears"))));
  }

  await look();
  return { leave: () => clearTimeout(timer) };
}
