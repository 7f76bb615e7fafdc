// Step Look: what the run has found, on the map, in the pictures and in plots.

import { h } from "../dom.js";

export function mount(element, context) {
  element.append(h("h1", {}, context.say("look.title")));
}
