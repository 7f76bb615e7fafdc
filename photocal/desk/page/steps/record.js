// Step of the window, see docs/guide/desk.md.

import { h } from "../dom.js";

export function mount(element, context) {
  element.append(h("h1", {}, context.say("step.record")));
}
