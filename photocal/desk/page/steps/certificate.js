// Step Certificate: particulars as a form, a preview that follows it, issue, sign, send; and a check of any other.

import { fill, h, said, sign } from "../dom.js";

const PREVIEW_MS = 700;
const POLL_MS = 1000;
// As long as the server takes a text.
const LONGEST = 2000;

export async function mount(element, context) {
  const { say } = context;
  const trouble = h("div", { role: "alert" });
  const form = h("form.card", { onsubmit: (event) => event.preventDefault() });
  const acts = h("section.card");
  const check = h("section.card");
  const frame = h("iframe.preview", { title: say("certificate.preview"), sandbox: "", src: "about:blank", tabindex: 0 });
  const shown = h("p.hint", {});
  element.append(h("div.split", {},
    h("div.pane", {}, h("h1", {}, say("certificate.title")), h("p.lead", {}, say("certificate.lead")), trouble, acts, form, check),
    h("div.paper", {}, shown, frame)));
  let state = null;
  let timer = 0;
  let poll = 0;
  let gone = false;

  async function act(promise) {
    fill(trouble);
    try {
      return await promise;
    } catch (failure) {
      fill(trouble, said("bad", labelled(failure.message)));
      trouble.scrollIntoView({ block: "nearest" });
      return null;
    }
  }

  const values = () => {
    const given = Object.fromEntries([...form.querySelectorAll("[data-particular]")].map((input) => [input.dataset.particular, input.value]));
    const own = (name) => form.querySelector(`[name=${name}]`)?.value ?? "";
    return { values: given, client: own("client"), operator: own("operator"), form: own("form"), language: own("language") };
  };

  async function preview() {
    shown.textContent = say("certificate.preparing");
    try {
      const answer = await context.post("/api/certificate/preview", values());
      if (gone) return;
      shown.textContent = say("certificate.previewed", { number: answer.number });
      frame.src = `/certificate/preview?${Date.now()}`;
    } catch (failure) {
      // Beside the preview, which is in sight wherever the form is scrolled to.
      fill(shown, said("bad", h("span", { role: "alert" }, labelled(failure.message))));
    }
  }

  /** A message with the label of the field that it begins with, as it stands in the form. */
  function labelled(message) {
    const field = state?.fields.find((one) => message.startsWith(`${one.key} `));
    return field ? say(`particular.${field.key}`) + message.slice(field.key.length) : message;
  }

  function changed() {
    clearTimeout(timer);
    timer = setTimeout(preview, PREVIEW_MS);
  }

  function drawForm() {
    const sections = [...new Set(state.fields.map((field) => field.section))];
    const entry = (field) => h("div.field", {}, h("label", { for: field.key }, say(`particular.${field.key}`)),
      h("input", { id: field.key, "data-particular": field.key, maxlength: LONGEST, value: field.value, type: field.kind === "date" ? "date" : "text", inputmode: field.kind === "number" ? "decimal" : null, placeholder: field.told, oninput: changed }));
    const own = (name, label) => h("div.field", {}, h("label", { for: name }, label), h("input", { id: name, name, maxlength: LONGEST, value: state[name], oninput: changed }));
    fill(form,
      h("h2", {}, say("certificate.particulars")),
      h("p.hint", {}, say("certificate.told")),
      h("div.fields", {}, own("client", say("field.certificate.client")), own("operator", say("field.certificate.operator")),
        h("div.field", {}, h("label", { for: "form" }, say("field.certificate.form")),
          h("select", { id: "form", name: "form", onchange: changed }, ["", "br-md"].map((one) => h("option", { value: one, selected: one === state.form }, say(`choice.certificate.form.${one}`))))),
        h("div.field", {}, h("label", { for: "language" }, say("field.certificate.language")),
          h("select", { id: "language", name: "language", onchange: changed }, ["en", "pt-BR"].map((one) => h("option", { value: one, selected: one === state.language }, say(`choice.certificate.language.${one}`)))),
          h("p.hint", {}, say("certificate.language-rule")))),
      sections.map((section, k) => {
        const fields = state.fields.filter((field) => field.section === section);
        return h("details", { open: k === 0 || fields.some((field) => field.value) }, h("summary", {}, say(`section.${section}`)), h("div.fields", {}, fields.map(entry)));
      }));
  }

  function drawActs() {
    const { issued, key, lines } = state;
    const issue = h("button.main", { type: "button", onclick: make }, say(issued ? "certificate.issue-again" : "certificate.issue"));
    const verdict = issued?.verdict;
    fill(acts,
      h("h2", {}, say("certificate.issued")),
      !issued && h("p.quiet", {}, say("certificate.none")),
      issued && h("p", {}, h("b", {}, issued.number), " · ", issued.date, " ", sign(issued.signed ? "good" : "warn", say(issued.signed ? "stands.signed" : "stands.unsigned"))),
      verdict && said({ passed: "good", note: "good", doubtful: "warn" }[verdict.severity] ?? "bad", h("p", {}, verdict.paragraph),
        verdict.said?.length > 0 && h("ul", {}, verdict.said.map((line) => h("li", {}, line)))),
      h("p.buttons", {}, issue, issued && h("a.button", { href: "/certificate/zip", download: "" }, say("certificate.zip"))),
      issued && (key ? signing(key) : making()));
    context.command(issued && !issued.signed ? (key ? lines.sign : lines.key) : lines.issue);
  }

  function signing(key) {
    if (state.issued.signed) return null;
    const word = h("input", { id: "passphrase", type: "password", autocomplete: "off" });
    const go = h("button", {}, say("certificate.sign"));
    const send = async (event) => {
      event.preventDefault();
      go.disabled = true;
      const answer = await act(context.post("/api/certificate/sign", { passphrase: word.value }));
      if (answer) take(answer, false);
      else go.disabled = false;
    };
    return h("form", { onsubmit: send }, h("p.hint", {}, say("certificate.key", { name: key.name }), " ", h("code", {}, key.fingerprint)),
      h("p.row", {}, h("label", { for: "passphrase" }, say("certificate.passphrase")), word, go));
  }

  function making() {
    const name = h("input", { id: "key-name", maxlength: 100, required: true });
    const word = h("input", { id: "passphrase", type: "password", autocomplete: "new-password" });
    const go = h("button", {}, say("certificate.make-key"));
    const send = async (event) => {
      event.preventDefault();
      go.disabled = true;
      const answer = await act(context.post("/api/certificate/key", { name: name.value, passphrase: word.value }));
      if (answer) take(answer, false);
      else go.disabled = false;
    };
    return h("form", { onsubmit: send }, h("p.hint", {}, say("certificate.no-key")),
      h("p.row", {}, h("label", { for: "key-name" }, say("certificate.key-name")), name, h("label", { for: "passphrase" }, say("certificate.passphrase")), word, go));
  }

  // Written, then made by a run: only what has changed is made again.
  async function make() {
    // What is about to be issued anew is not signed.
    for (const one of acts.querySelectorAll("button")) one.disabled = true;
    const begun = (await act(context.post("/api/certificate/set", values()))) && (await act(context.post("/api/run/start", {})));
    if (begun) await follow();
    else drawActs();
  }

  async function follow() {
    const run = await act(context.get("/api/run"));
    if (gone || !run) return;
    if (run.job.state === "busy") {
      const busy = run.stages.find((stage) => stage.state === "busy");
      fill(acts, h("h2", {}, say("certificate.issued")), h("p", {}, sign("busy", say("certificate.making"))), h("progress", {}),
        busy && h("p.hint", {}, busy.ours ? say(`stage.${busy.name}`) : busy.name));
      poll = setTimeout(follow, POLL_MS);
      return;
    }
    take(await act(context.get("/api/certificate")), true);
    if (run.error) fill(trouble, said("bad", run.error.text));
  }

  function take(answer, anew) {
    if (!answer || gone) return;
    state = answer;
    if (anew) drawForm();
    drawActs();
    context.renew();
  }

  function drawCheck() {
    const result = h("div", { "aria-live": "polite" });
    const file = h("input", { type: "file", accept: ".zip", id: "sent", onchange: () => file.files[0] && verify(file.files[0]) });
    const drop = h("label.drop", { for: "sent", ondragover: (event) => { event.preventDefault(); drop.classList.add("over"); }, ondragleave: () => drop.classList.remove("over"), ondrop: (event) => { event.preventDefault(); drop.classList.remove("over"); if (event.dataTransfer.files[0]) verify(event.dataTransfer.files[0]); } }, say("certificate.drop"), file);
    async function verify(sent) {
      fill(result, h("p", {}, sign("busy", say("certificate.verifying", { name: sent.name }))));
      try {
        const answer = await fetch("/api/verify", { method: "POST", headers: { "content-type": "application/zip" }, body: sent });
        const told = await answer.json();
        if (!answer.ok) throw new Error(told.error);
        const state = told.verified && told.authentic ? "good" : told.verified ? "warn" : "bad";
        fill(result, said(state,
          h("p", {}, h("b", {}, told.number)),
          h("p", {}, sign(told.reproducible ? "good" : "bad", say(told.reproducible ? "certificate.reproducible" : "certificate.not-reproducible"))),
          h("p", {}, sign(told.authentic ? "good" : told.signature.trust === "forged" ? "bad" : "warn", say(`trust.${told.signature.trust}`)), " ", told.signature.name, " ", h("code", {}, told.signature.fingerprint)),
          h("ul", {}, (told.problems ?? []).slice(0, 20).map((line) => h("li", {}, line)))));
      } catch (failure) {
        fill(result, said("bad", failure.message));
      }
    }
    fill(check, h("h2", {}, say("certificate.verify")), drop, result);
  }

  state = await act(context.get("/api/certificate"));
  drawCheck();
  if (state) {
    drawForm();
    drawActs();
    frame.hidden = !state.ready;
    // What was issued is there at once; what would be issued takes a moment.
    if (state.issued) frame.src = "/certificate/preview";
    if (state.ready) preview();
    else fill(shown, say("certificate.not-ready"));
  }
  return {
    leave() {
      gone = true;
      clearTimeout(timer);
      clearTimeout(poll);
    },
  };
}
