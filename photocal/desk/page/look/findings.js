// The list of findings, the worst first, with remedies; what is left out by hand; and the run that takes it in.

import { fill, h, sign } from "../dom.js";

const EVERY_MS = 1000;
const SIGNS = { bad: "bad", warn: "warn", note: "none" };

/** The left column. */
export function findingsList(shared) {
  const { say, block, selection } = shared;
  const { lines, paragraph, outcome } = block.findings;
  const items = lines.map((line, k) => item(line, k));
  const groups = ["bad", "warn", "note"].map((kind) => group(kind, items.filter((_, k) => lines[k].kind === kind)));
  const left = h("div.left", {});
  const list = h("div.list", {}, groups.filter(Boolean));
  if (!lines.length) list.append(h("p.quiet", {}, say("look.nothing-found")));
  list.addEventListener("keydown", walk);
  selection.listen(mark);
  shared.leaving.listen((state) => fill(left, leftOut(state)));
  return h(
    "aside.findings",
    { "aria-label": say("look.findings") },
    h("div.summary", {}, sign({ usable: "good", "usable-with-reservations": "warn" }[outcome] ?? (outcome ? "bad" : "none"), outcome ? say(`look.outcome.${outcome}`) : say("look.no-verdict")), h("p", {}, paragraph)),
    list,
    left,
  );

  function group(kind, children) {
    return children.length ? h("section", {}, h("h2", {}, say(`look.kind.${kind}`, { n: children.length })), h("ul", {}, children)) : null;
  }

  function item(line, k) {
    const { images, points, observations, parameters } = line.concerns;
    const concerned = [
      observations.length && say("look.n-marks", { n: observations.length }),
      points.length && say("look.n-points", { n: points.length }),
      images.length && say("look.n-images", { n: images.length }),
      parameters.length && say("look.n-parameters", { n: parameters.length }),
    ].filter(Boolean);
    const details = line.details.length > 1 && h("details", {}, h("summary", {}, say("look.all-of-them", { n: line.details.length })), h("ul", {}, line.details.map((text) => h("li", {}, text))));
    return h(
      "li.finding",
      { id: `finding-${k}` },
      h(
        "button.line",
        { type: "button", "aria-pressed": "false", onclick: () => (chosen(k) ? selection.clear() : selection.finding(k)) },
        sign(SIGNS[line.kind]),
        h("span.text", {}, line.text, line.remedy && h("span.remedy", {}, line.remedy)),
        concerned.length > 0 && h("span.concerns", {}, concerned.join(" · ")),
      ),
      details,
    );
  }

  function chosen(k) {
    return selection.now.kind === "finding" && selection.now.name === k;
  }

  function mark() {
    items.forEach((element, k) => {
      const here = chosen(k) || selection.now.from === k;
      element.classList.toggle("chosen", here);
      element.firstElementChild.setAttribute("aria-pressed", here);
      if (here) element.scrollIntoView({ block: "nearest" });
    });
  }

  /** Up and down through the findings. */
  function walk(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const buttons = [...list.querySelectorAll("button.line")];
    const here = buttons.indexOf(document.activeElement);
    if (!step || here < 0) return;
    event.preventDefault();
    buttons[Math.min(Math.max(here + step, 0), buttons.length - 1)].focus();
  }

  function leftOut({ entries, waiting }) {
    if (!entries.length && !waiting) return [];
    const row = (entry) =>
      h(
        "li",
        {},
        h("span", {}, h("b", {}, [entry.point, entry.image].filter(Boolean).join(" / ")), ` ${entry.reason}`),
        h("button.small", { type: "button", onclick: () => shared.leaving.takeBack(entry), "aria-label": say("look.undo-of", { name: [entry.point, entry.image].filter(Boolean).join(" / ") }) }, say("look.undo")),
      );
    return [
      h("h2", {}, say("look.left-out", { n: entries.length })),
      h("ul", {}, entries.map(row)),
      waiting && h("div.waiting", {}, h("p", {}, sign("warn"), ` ${say("look.waiting")}`), runAgain(shared)),
    ];
  }
}

/** A button that starts the run and follows it; only the stages after the change are made again. */
function runAgain(shared) {
  const { say } = shared;
  const told = h("span.quiet", { role: "status" });
  const button = h("button.main", { type: "button", onclick: start }, say("look.run-again"));
  return h("div.again", {}, button, told);

  async function start() {
    button.disabled = true;
    try {
      follow(await shared.post("/api/run/start"));
    } catch (refusal) {
      stop(refusal.message);
    }
  }

  async function follow(state) {
    if (!button.isConnected) return;
    if (state.job.state === "busy") {
      told.textContent = state.progress?.title ?? say("look.running");
      setTimeout(() => shared.get("/api/run").then(follow, (refusal) => stop(refusal.message)), EVERY_MS);
    } else if (state.job.state === "done") {
      shared.again();
    } else {
      stop(state.error?.text ?? say("look.run-ended"));
    }
  }

  function stop(text) {
    button.disabled = false;
    told.textContent = text;
  }
}
