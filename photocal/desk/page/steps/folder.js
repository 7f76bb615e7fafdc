// Step Folder: choose it, see what was found, answer what is asked; the project file as a form.

import { fill, h, said, script, sign, styles } from "../dom.js";
import { number } from "../look/colours.js";
import { crop } from "../look/tiles.js";

// So much of a picture is seen around a mark, and tiles are so large.
const HALF_PX = 60;
const TILE_PX = 512;
const HEIGHTS = ["ellipsoidal", "orthometric", "local"];

export async function mount(element, context) {
  const { say } = context;
  const chooser = h("section.card");
  const found = h("section.card");
  const form = h("section.card");
  const map = h("section.card");
  const trouble = h("div", { role: "alert" });
  element.append(
    h("h1", {}, say("folder.title")), h("p.lead", {}, say("folder.lead")), trouble,
    h("div.columns", {}, h("div", {}, chooser, found), h("div", {}, form, map)),
  );
  let chart = null;
  let browsed = "";

  async function act(promise) {
    fill(trouble);
    try {
      return await promise;
    } catch (failure) {
      tell(failure.message);
      return null;
    }
  }

  function tell(text) {
    fill(trouble, said("bad", text));
    trouble.scrollIntoView({ block: "nearest" });
  }

  async function choose(path, browse = path) {
    if (path !== null) {
      if (!(await act(context.post("/api/open", { path })))) return;
      localStorage.setItem(`folder ${context.state.root}`, path);
      await context.renew();
      await show();
    }
    await list(browse);
  }

  async function list(path = browsed) {
    browsed = path;
    const listed = await act(context.get(`/api/folders?path=${encodeURIComponent(path)}`));
    if (!listed) return;
    const row = (entry, name) =>
      h("li", {}, h("button.plain", { type: "button", "aria-current": entry.path === context.state.folder ? "true" : null, onclick: () => choose(entry.path) },
        h("span.icon", { "aria-hidden": "true" }, entry.project ? "▣" : "▢"), h("span", {}, name),
        h("span.quiet", {}, counted(entry))));
    fill(
      chooser,
      h("h2", {}, say("folder.choose")),
      h("p.path", {}, h("code", {}, context.state.root)),
      h("ul.list", {},
        listed.up !== null && h("li", {}, h("button.plain", { type: "button", onclick: () => list(listed.up) }, "↑ ", say("folder.up"))),
        row(listed.here, listed.path === "." ? say("folder.itself") : listed.here.name),
        listed.folders.map((entry) => row(entry, entry.name)),
        listed.more > 0 && h("li.quiet", {}, say("folder.more", { n: listed.more })),
      ),
    );
  }

  function counted(entry) {
    const parts = [];
    if (entry.pictures) parts.push(say("folder.pictures", { n: entry.pictures }));
    if (entry.logs) parts.push(say("folder.logs", { n: entry.logs }));
    if (entry.project) parts.push(say("folder.project"));
    return parts.join(" · ");
  }

  async function show() {
    const project = await act(context.get("/api/project"));
    if (project) draw(project);
    await places();
  }

  function draw(project) {
    context.command(project.said?.line ?? project.line);
    drawFound(project);
    drawForm(project);
    context.renew();
  }

  function drawFound(project) {
    const told = project.said;
    const lines = (kind, state) => (told?.[kind] ?? []).map((text) => h("li", {}, sign(state), " ", text));
    const look = h("button", { type: "button", class: project.form ? null : "main" }, say(project.form ? "folder.again" : "folder.look"));
    look.onclick = async () => {
      look.disabled = true;
      look.textContent = say("folder.looking");
      const answer = await act(context.post("/api/new", {}));
      if (answer) draw(answer);
      else drawFound(project);
      // It is a project now.
      if (answer) await list();
      await places();
    };
    fill(
      found,
      h("h2", {}, say("folder.found")),
      !told && h("p.quiet", {}, say(project.form ? "folder.not-looked" : "folder.nothing-yet")),
      told && h("ul.findings", {}, lines("asked", "bad"), lines("doubtful", "warn"), lines("found", "good"), lines("missing", "none")),
      told?.rows?.read > 0 && h("p", {}, say("folder.rows", { used: told.rows.used, read: told.rows.read })),
      frames(project),
      h("p.buttons", {}, look),
    );
  }

  // Marks that were made in pictures of another size or turn: what each means is seen in the pictures.
  function frames(project) {
    const { frames: offers, marks } = project;
    if (!offers?.length) return null;
    const choose = async (frame) => {
      fill(box, h("legend", {}, say("field.marks")), h("p.quiet", { role: "status" }, say("folder.looking")));
      const answer = await act(context.post("/api/new", { marks: frame }));
      draw(answer ?? project);
      // Who goes by keys stays where they are.
      found.querySelector(".frames :checked")?.focus();
      await places();
    };
    const offer = (one, k) => {
      const facts = [k === 0 && !one.outside && say("frame.best"), one.outside > 0 && say("frame.outside", { n: one.outside }), one.miss !== null && say("frame.miss", { share: number(100 * one.miss, context.language, 2) })];
      return h("div.frame-offer", {},
        h("label", {}, h("input", { type: "radio", name: "marks", value: one.frame, checked: marks ? marks === one.frame : one.chosen, onchange: () => choose(one.frame) }),
          h("b", {}, worded(one.frame))),
        h("span.hint", {}, facts.filter(Boolean).join(" · ")),
        h("div.row", {}, one.marks.map((mark) => h("figure", {}, crop(mark.image, [mark.x, mark.y], [null, null], TILE_PX, HALF_PX), h("figcaption", {}, `${mark.point}, ${mark.image}`)))));
    };
    const box = h("fieldset.frames", {}, h("legend", {}, say("field.marks")), h("p.hint", {}, say("frame.which")), offers.map(offer));
    return box;
  }

  // "1/2 exif" in words: a size, a turn or other axes, or both.
  function worded(frame) {
    return frame.split(" ").map((part) => (["1", "exif", "bottom", "swapped"].includes(part) ? say(`frame.${part}`) : ["90", "180", "270"].includes(part) ? say("frame.turned", { angle: part }) : say("frame.size", { size: part }))).join(", ");
  }

  function drawForm(project) {
    form.hidden = map.hidden = !project.form;
    if (!project.form) return;
    const { fields, problem } = project.form;
    fill(
      form,
      h("h2", {}, say("folder.form")),
      problem && !fields.some((field) => field.key === problem.field) && said("bad", problem.text),
      fields.filter((field) => !field.key.startsWith("certificate.")).map((field) => control(field, problem)),
      h("details", {}, h("summary", {}, "project.toml"), h("pre", { tabindex: 0 }, project.form.text)),
    );
    const wanted = context.parts[0];
    if (wanted) {
      document.getElementById(wanted)?.focus();
      context.parts = [];
    }
  }

  async function set(key, value) {
    const answer = await act(context.post("/api/set", { key, value }));
    if (!answer) return;
    context.announce(say("folder.written"));
    drawForm(answer);
    context.command(`${say("folder.in-file")}: ${key.split(".")[1]} = ${JSON.stringify(value)}`);
    context.renew();
    await places();
  }

  function control(field, problem) {
    const id = field.key;
    const wrong = problem?.field === field.key ? problem.text : "";
    const entry = { system, height, choice, triple, text }[field.kind](field, id);
    return h(`div.field${wrong || field.asked ? ".wanted" : ""}`, {},
      h("label", { for: id }, say(`field.${field.key}`)), entry,
      field.asked && h("p.hint.bad", {}, say("folder.asked")),
      wrong && !field.asked && h("p.hint.bad", { role: "alert" }, wrong),
      field.comment && h("p.hint", {}, field.comment));
  }

  function text(field, id) {
    return h("input", { id, maxlength: 300, value: field.value ?? "", onchange: (event) => set(field.key, event.target.value) });
  }

  function choice(field, id) {
    return h("select", { id, onchange: (event) => set(field.key, event.target.value) },
      field.choices.map((one) => h("option", { value: one, selected: one === field.value }, say(`choice.${field.key}.${one}`))));
  }

  function triple(field, id) {
    const values = Array.isArray(field.value) ? field.value : ["", "", ""];
    const names = say(`parts.${field.key}`).split("|");
    const inputs = values.map((value, k) => h("input", { id: k ? `${id}.${k}` : id, inputmode: "decimal", value, "aria-label": names[k], placeholder: names[k], onchange: send }));
    function send() {
      const numbers = inputs.map((input) => (input.value.trim() ? Number(input.value.replace(",", ".")) : NaN));
      const wrong = inputs.find((input, k) => input.value.trim() && !Number.isFinite(numbers[k]));
      if (wrong) tell(say("folder.no-number", { field: say(`field.${field.key}`), text: wrong.value }));
      else if (numbers.every(Number.isFinite)) set(field.key, numbers);
    }
    return h("span.triple", {}, inputs);
  }

  // Name, number or country of a system; what the register offers stands below.
  function system(field, id) {
    const offers = h("ul.offers", { hidden: true });
    let asked = 0;
    const input = h("input", { id, value: field.value ?? "", autocomplete: "off", placeholder: say("folder.search"), "aria-describedby": `${id}-offers`, oninput: search, onkeydown: keys });
    offers.id = `${id}-offers`;
    async function search() {
      const mine = ++asked;
      await new Promise((done) => setTimeout(done, 250));
      if (mine !== asked) return;
      const answer = await act(context.get(`/api/systems?text=${encodeURIComponent(input.value)}`));
      if (!answer || mine !== asked) return;
      offers.hidden = false;
      const offer = (code, name, area) => h("li", {}, h("button.plain", { type: "button", onclick: () => take(code) }, h("b", {}, code), h("span", {}, name), h("span.quiet", {}, area)));
      fill(offers, !answer.found && input.value.trim() && h("li.quiet", { role: "status" }, say("folder.not-found", { text: input.value.trim() })), answer.systems.map((one) => offer(one.code, one.name, one.area)), offer("local", say("folder.local"), ""));
    }
    // What is searched still may not wipe away what is said of the choice.
    function take(code) {
      asked += 1;
      set(field.key, code);
    }
    function keys(event) {
      if (event.key === "Enter") take(input.value.trim());
      if (event.key === "ArrowDown") offers.querySelector("button")?.focus();
    }
    if (!field.value) search();
    return h("span", {}, h("span.row", {}, input, h("button", { type: "button", onclick: () => take(input.value.trim()) }, say("folder.set"))), offers);
  }

  function height(field, id) {
    return h("fieldset.heights", { id, tabindex: -1 }, h("legend.unseen", {}, say(`field.${field.key}`)),
      HEIGHTS.map((kind) => h("label", {},
        h("input", { type: "radio", name: id, value: kind, checked: kind === field.value, onchange: () => set(field.key, kind) }),
        h("img", { src: `/heights-${kind}.svg`, alt: "", width: 132, height: 66 }),
        h("b", {}, say(`choice.project.height.${kind}`)), h("span.hint", {}, say(`hint.project.height.${kind}`)))));
  }

  async function places() {
    if (map.hidden) return;
    const known = await act(context.get("/api/places"));
    if (known) await drawPlaces(known);
  }

  async function drawPlaces(known) {
    const { points, pictures } = known;
    map.hidden = !points.length && !pictures.length;
    if (map.hidden) return;
    const area = h("div.chart", { id: "chart", tabindex: 0, role: "application", "aria-label": say("folder.map") });
    const roles = async (point) => {
      const answer = await act(context.post("/api/role", { point: point.name, role: point.role === "check" ? "control" : "check" }));
      if (!answer) return;
      const rows = [...map.querySelectorAll(".points button")];
      const here = rows.indexOf(document.activeElement);
      drawPlaces(answer);
      // Who goes by keys stays where they are.
      if (here >= 0) map.querySelectorAll(".points button")[here]?.focus();
    };
    fill(
      map,
      h("h2", {}, say("folder.map")),
      area,
      points.length > 0 && h("p.hint", {}, say("folder.roles")),
      points.length > 0 && h("ul.points", {}, points.map((point) =>
        h("li", {}, h("button.plain", { type: "button", "aria-pressed": String(point.role === "check"), onclick: () => roles(point) },
          h(`span.mark.${point.role}`, { "aria-hidden": "true" }, point.role === "check" ? "◆" : "▲"), point.name, h("span.quiet", {}, say(`role.${point.role}`)))))),
    );
    styles("/vendor/ol.css");
    await script("/vendor/ol.js");
    const { flatMap } = await import("./flat-map.js");
    chart?.setTarget(null);
    chart = flatMap(area, [
      { name: "pictures", places: pictures.map((one) => ({ at: one.place_deg, title: one.name })), colour: "#0b5cad", radius: 4 },
      { name: "control", places: points.filter((one) => one.role !== "check" && one.place_deg).map((one) => ({ at: one.place_deg, title: one.name, value: one })), colour: "#b00020", sides: 3, radius: 8, label: true },
      { name: "check", places: points.filter((one) => one.role === "check" && one.place_deg).map((one) => ({ at: one.place_deg, title: one.name, value: one })), colour: "#7a3fa0", sides: 4, radius: 8, label: true },
    ], (place) => place.value && roles(place.value));
  }

  await list(context.state.folder);
  await show();
  return {
    leave: () => chart?.setTarget(null),
    route(parts) {
      document.getElementById(parts[0] ?? "")?.focus();
    },
  };
}
