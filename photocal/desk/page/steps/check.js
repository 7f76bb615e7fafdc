// Step Check: the machine, the inputs against each other, and the debrief, live while pictures arrive.

import { fill, h, said, script, sign, styles } from "../dom.js";

const EVERY_MS = 1500;
const STATES = { good: "good", poor: "warn", bad: "bad" };
const COLOURS = { fixed: "#0a6b3d", float: "#b87400", single: "#b00020", none: "#4b5963" };
const SIDES = { fixed: 0, float: 4, single: 3, none: 5 };

export async function mount(element, context) {
  const { say } = context;
  const trouble = h("div", { role: "alert" });
  const machine = h("section.card");
  const inputs = h("section.card");
  const flight = h("section.card");
  element.append(h("h1", {}, say("check.title")), h("p.lead", {}, say("check.lead")), trouble,
    h("div.columns", {}, h("div", {}, inputs, machine), h("div", {}, flight)));
  let timer = 0;
  let chart = null;
  let drawn = "";
  const pictures = (await context.get("/api/places").catch(() => ({ pictures: [] }))).pictures;

  async function step(asking) {
    clearTimeout(timer);
    try {
      const state = await asking;
      fill(trouble);
      draw(state);
      if (state.job.state === "busy" || state.running) timer = setTimeout(() => step(context.get("/api/check")), EVERY_MS);
    } catch (failure) {
      fill(trouble, said("bad", failure.message));
    }
  }

  function draw(state) {
    const { checked } = state;
    context.command(state.job.state === "busy" ? state.job.line : state.lines.doctor);
    const anew = h("button", { type: "button", class: checked ? null : "main", onclick: () => { anew.disabled = true; anew.textContent = say("check.looking"); step(context.post("/api/check/start").finally(context.renew)); } }, say(checked ? "check.again" : "check.start"));
    fill(inputs, h("h2", {}, say("check.inputs")),
      !checked && h("p.quiet", {}, say("check.not-yet")),
      checked && state.changed && said("warn", say("check.changed")),
      checked && !checked.problem && h("p", {}, sign("good", say("check.agree"))),
      checked?.problem && said("bad", h("p", {}, checked.problem.text), checked.problem.field && h("a.button", { href: `#/folder/${encodeURIComponent(checked.problem.field)}` }, say("run.mend"), " ", say(`field.${checked.problem.field}`))),
      h("p.buttons", {}, anew));
    machine.hidden = !checked;
    if (checked) {
      const order = ["bad", "poor", "good"];
      const rows = [...checked.machine].sort((a, b) => order.indexOf(a.state) - order.indexOf(b.state));
      fill(machine, h("h2", {}, say("check.machine")), h("table.plain", {}, h("tbody", {}, rows.map((row) =>
        h("tr", {}, h("th", { scope: "row" }, row.part), h("td", {}, sign(STATES[row.state], say(`state.${row.state}`))), h("td", {}, row.text, row.remedy && h("span.hint", {}, row.remedy)))))));
    }
    drawFlight(state);
  }

  function drawFlight(state) {
    const { debrief, job } = state;
    const busy = job.state === "busy";
    const start = (live) => () => step(context.post("/api/debrief/start", { live }));
    const area = h("div.chart", { tabindex: 0, role: "application", "aria-label": say("check.map") });
    const flown = (debrief?.exposures ?? []).filter((one) => one.place_deg).map((one) => ({ ...one, place_deg: [one.place_deg[1], one.place_deg[0]] }));
    // Without a log pictures say themselves where they were taken.
    const places = flown.length ? flown : pictures.map((one) => ({ image: one.name, place_deg: one.place_deg }));
    const key = JSON.stringify([places, debrief?.coverage?.holes_deg]);
    const kept = drawn === key && chart ? chart.getTargetElement() : null;
    fill(flight, h("h2", {}, say("check.flight")),
      state.error && said("bad", state.error.text),
      !debrief && !busy && h("p.quiet", {}, say("check.no-debrief")),
      busy && h("p", {}, sign("busy", say("check.debriefing"))),
      debrief && said({ passed: "good", doubtful: "warn" }[debrief.verdict.severity] ?? "bad", debrief.verdict.text),
      debrief && h("ul.findings", {}, debrief.findings.map((one) => h("li", {}, sign({ grave: "bad", refused: "bad", doubtful: "warn" }[one.severity] ?? "none"), " ", one.text))),
      places.length > 0 && (kept ?? area),
      places.length > 0 && legend(places),
      debrief && h("ul.figures", {}, debrief.summary.map((line) => h("li", {}, line))),
      state.running && h("p.hint", {}, say("check.running")),
      h("p.buttons", {},
        busy && h("button", { type: "button", onclick: () => step(context.post("/api/debrief/stop")) }, say("run.stop")),
        !busy && h("button", { type: "button", disabled: state.running, onclick: start(false) }, say("check.debrief")),
        !busy && h("button", { type: "button", disabled: state.running, onclick: start(true) }, say("check.live"))));
    if (places.length && !kept) {
      drawn = key;
      drawMap(area, places, debrief?.coverage);
    }
  }

  const states = (places) => [...new Set(places.map((one) => one.state ?? "none"))];

  function legend(places) {
    return h("ul.legend", {}, states(places).map((state) => h("li", {}, h(`span.dot.${state}`, { "aria-hidden": "true" }), say(`fix.${state}`))));
  }

  async function drawMap(area, places, coverage) {
    styles("/vendor/ol.css");
    await script("/vendor/ol.js");
    const { flatMap } = await import("./flat-map.js");
    chart?.setTarget(null);
    const title = (one) => `${one.image ?? ""} ${one.strip ? say("check.strip", { n: one.strip }) : ""}`;
    const layers = states(places).map((state) => ({
      places: places.filter((one) => (one.state ?? "none") === state).map((one) => ({ at: one.place_deg, title: title(one) })),
      colour: COLOURS[state] ?? COLOURS.none, radius: 5, sides: SIDES[state] ?? 0,
    }));
    const holes = (coverage?.holes_deg ?? []).map(([latitude, longitude]) => ({ at: [longitude, latitude], title: say("check.hole") }));
    chart = flatMap(area, [...layers, { places: holes, colour: "#b00020", sides: 4, radius: 9, label: true }]);
  }

  await step(context.get("/api/check"));
  // What was checked in another language is checked again: nobody has asked for its words.
  if (machine.hidden && context.state.steps.check?.word) inputs.querySelector("button").click();
  return {
    leave() {
      clearTimeout(timer);
      chart?.setTarget(null);
    },
  };
}
