// Leaving out with a reason, and taking back: asked in a dialogue, written into project.toml.

import { fill, h } from "../dom.js";

const REASONS = ["place", "blurred", "hidden", "moved", "coordinates"];

/** What is left out, kept with the server; listeners are told. */
export function leaving(shared) {
  const { say } = shared;
  const listeners = new Set();
  let state = shared.block.left_out;

  async function change(path, entry) {
    state = await shared.post(path, entry);
    shared.command(`photocal run ${shared.state.folder && shared.state.folder !== "." ? shared.state.folder : "."}   # [[leave_out]] ${[entry.point, entry.image].filter(Boolean).join(" / ")}`);
    for (const listener of listeners) listener(state);
  }

  return {
    get entries() {
      return state.entries;
    },
    listen(listener) {
      listeners.add(listener);
      listener(state);
    },
    takeBack: (entry) => change("/api/look/take-back", entry).catch((refusal) => shared.announce(refusal.message)),
    has: (image, point) => state.entries.some((entry) => [null, image].includes(entry.image) && [null, point].includes(entry.point)),
    /** Ask for the reason, and leave it out. */
    ask(entry) {
      if (!entry) return;
      const title = entry.image && entry.point ? "mark" : entry.point ? "point" : "image";
      const reason = h("input", { id: "reason", name: "reason", required: true, maxlength: 400, autocomplete: "off", "aria-describedby": "reason-where" });
      const trouble = h("p.trouble", { role: "alert" });
      const choose = (text) => () => {
        reason.value = text;
        reason.focus();
      };
      const texts = REASONS.map((key) => say(`look.reason.${key}`));
      const form = h(
        "form",
        { method: "dialog", onsubmit: submit },
        h("h2", { id: "leave-title" }, say(`look.leave.${title}`, { point: entry.point ?? "", image: entry.image ?? "" })),
        h("label", { for: "reason" }, say("look.reason")),
        reason,
        h("div.reasons", {}, texts.map((text) => h("button.small", { type: "button", onclick: choose(text) }, text))),
        h("p.quiet", { id: "reason-where" }, say("look.reason-where")),
        trouble,
        h("div.buttons", {}, h("button", { type: "button", onclick: () => dialog.close() }, say("look.cancel")), h("button.main", {}, say("look.leave-now"))),
      );
      const dialog = h("dialog.leave", { "aria-labelledby": "leave-title", onclose: () => dialog.remove() }, form);
      document.body.append(dialog);
      dialog.showModal();
      reason.focus();

      async function submit(event) {
        event.preventDefault();
        try {
          await change("/api/look/leave-out", { ...entry, reason: reason.value.trim() });
          dialog.close();
        } catch (refusal) {
          fill(trouble, refusal.message);
        }
      }
    },
  };
}
