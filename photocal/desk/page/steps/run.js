// Step Run: the stages as bars with one total time; stop, go on, log; an error with a way to what mends it.

import { fill, h, said, sign } from "../dom.js";

const EVERY_MS = 1000;
// How often a run is asked for while none is at work: one may be started elsewhere.
const IDLE_MS = 5000;
const STATES = { made: "good", kept: "good", there: "good", busy: "busy", waits: "none", none: "none" };

export async function mount(element, context) {
  const { say } = context;
  const trouble = h("div", { role: "alert" });
  const head = h("section.card.total");
  const bars = h("ol.stages");
  const log = h("pre", { tabindex: 0 });
  const details = h("details", { ontoggle: () => details.open && tellLog() }, h("summary", {}, say("run.log")), log);
  element.append(h("h1", {}, say("run.title")), h("p.lead", {}, say("run.lead")), trouble, head, h("section.card", {}, bars, details));
  let timer = 0;
  let last = "";

  async function tellLog() {
    const answer = await context.get("/api/run/log").catch(() => null);
    if (answer) log.textContent = answer.log || say("run.no-log");
  }

  async function step(asking) {
    clearTimeout(timer);
    let state = null;
    try {
      state = await asking;
      draw(state);
    } catch (failure) {
      fill(trouble, said("bad", failure.message));
    }
    timer = setTimeout(() => step(context.get("/api/run")), state?.job.state === "busy" ? EVERY_MS : IDLE_MS);
  }

  function draw(state) {
    const { job } = state;
    if (job.state !== last) {
      if (last) context.announce(say(`run.${job.state}`));
      last = job.state;
      context.command(job.line || state.line);
      context.renew();
    }
    const wanted = state.error;
    fill(trouble, wanted && said("bad", h("p", {}, wanted.text), wanted.field && mend(wanted.field)),
      job.state === "stopped" && said("warn", say("run.sound")),
      state.debriefing && said("warn", h("p", {}, say("run.debriefing")), h("a.button", { href: "#/check" }, say("step.check"))));
    if (details.open) tellLog();
    drawHead(state);
    drawBars(state);
  }

  function mend(field) {
    const place = field === "certificate.particulars" ? "#/certificate" : `#/folder/${encodeURIComponent(field)}`;
    return h("a.button", { href: place }, say("run.mend"), " ", say(`field.${field}`));
  }

  function drawHead(state) {
    const { job, stages } = state;
    const busy = job.state === "busy";
    const share = total(state);
    const start = h("button.main", { id: "start", type: "button", disabled: busy || state.debriefing || !stages.length, onclick: () => step(context.post("/api/run/start", {})) }, say(startWord(state)));
    const stop = h("button", { id: "stop", type: "button", hidden: !busy, onclick: () => { stop.disabled = true; stop.textContent = say("run.stopping"); step(context.post("/api/run/stop", {})); } }, say("run.stop"));
    const seconds = job.began ? Date.now() / 1000 - job.began : 0;
    fill(head,
      h("div.row", {},
        sign(busy ? "busy" : job.state === "failed" ? "bad" : job.state === "stopped" ? "warn" : share === 1 ? "good" : "none", say(`run.${share === 1 && !busy && job.state === "none" ? "done" : job.state}`)),
        busy && h("span.time", {}, say("run.elapsed", { time: clock(seconds) })),
        busy && h("span.time", {}, left(state)),
        h("span.buttons", {}, stop, start)),
      h("progress", { max: 1, value: share, "aria-label": say("run.whole") }),
      state.verdict && verdict(state));
  }

  function startWord(state) {
    if (["stopped", "failed"].includes(state.job.state)) return "run.go-on";
    if (state.job.state === "busy") return "run.start";
    return state.stages.every((stage) => stage.state !== "none") && state.stages.length ? "run.anew" : "run.start";
  }

  function verdict(state) {
    const tone = { passed: "good", note: "good", doubtful: "warn" }[state.verdict.severity] ?? "bad";
    return h("div.verdict", {}, said(tone, h("p", {}, state.verdict.paragraph), h("ul", {}, (state.verdict.said ?? []).map((line) => h("li", {}, line)))),
      h("a.button", { href: "#/look" }, say("run.look")), " ", h("a.button", { href: "#/certificate" }, say("run.certificate")));
  }

  // Share of the whole: as the run tells while it works, else how many of its stages are made.
  function total({ job, stages, progress }) {
    if (job.state === "busy") return progress?.run?.share ?? 0;
    return stages.filter((stage) => STATES[stage.state] === "good").length / (stages.length || 1);
  }

  function left({ progress }) {
    const seconds = progress?.run?.left_s;
    return seconds === null || seconds === undefined ? "" : say("run.left", { time: clock(seconds) });
  }

  function drawBars(state) {
    fill(bars, state.stages.map((stage, k) => {
      const busy = stage.state === "busy";
      const share = STATES[stage.state] === "good" ? 1 : busy ? state.progress?.share ?? null : 0;
      const name = stage.ours ? say(`stage.${stage.name}`) : stage.name;
      return h("li", { class: STATES[stage.state], "aria-current": busy ? "step" : null },
        h("span.number", { "aria-hidden": "true" }, k + 1),
        h("span.name", {}, name, busy && state.progress?.title && h("span.hint", {}, work(state.progress.title))),
        h("progress", { max: 1, value: share === null ? undefined : share, "aria-label": name }),
        sign(STATES[stage.state] ?? "none", say(`run.stage.${stage.state}`)),
        h("span.seconds", {}, stage.seconds && STATES[stage.state] === "good" ? clock(stage.seconds) : ""));
    }));
  }

  /** What is done within a stage; works of others tell their own titles. */
  function work(title) {
    const text = say(`work.${title}`);
    return text === `work.${title}` ? title : text;
  }

  function clock(seconds) {
    const whole = Math.max(0, Math.round(seconds));
    if (whole < 60) return `${whole} s`;
    const minutes = Math.floor(whole / 60);
    return minutes < 60 ? `${minutes} min ${whole % 60} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
  }

  await step(context.get("/api/run"));
  return { leave: () => clearTimeout(timer) };
}
