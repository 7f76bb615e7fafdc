// Elements made of names, attributes and children. Texts are texts: what a file is called is never read as HTML.

/** Make an element. Attributes that begin with "on" are listeners; null, undefined and false are left out. */
export function h(name, attributes = {}, ...children) {
  const [tag, ...classes] = name.split(".");
  const made = document.createElement(tag);
  if (classes.length) made.className = classes.join(" ");
  for (const [key, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (["value", "checked", "disabled", "hidden", "selected"].includes(key)) made[key] = value;
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

// A button or link that is replaced while it is pressed would never be clicked: what is drawn anew waits.
let pressed = null;
const waiting = new Map();

function released() {
  pressed = null;
  const drawn = [...waiting];
  waiting.clear();
  for (const [element, children] of drawn) fill(element, ...children);
}

addEventListener("pointerdown", (event) => (pressed = event.target), true);
// The click comes after the release.
for (const end of ["pointerup", "pointercancel"]) addEventListener(end, () => setTimeout(released), true);
addEventListener("blur", released);
addEventListener("click", () => (pressed = null), true);

/** Put new children into an element; what has the focus keeps it, where it has a name. */
export function fill(element, ...children) {
  waiting.delete(element);
  if (pressed && element !== pressed && element.contains(pressed)) {
    waiting.set(element, children);
    return element;
  }
  const focused = element.contains(document.activeElement) ? document.activeElement.id : "";
  element.replaceChildren(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  if (focused) document.getElementById(focused)?.focus();
  return element;
}

/** A state as sign, word and colour: good, warn, bad, busy or none. */
export function sign(state, word = "") {
  const signs = { good: "✓", warn: "▲", bad: "✕", busy: "●", none: "○" };
  return h(`span.sign.${state}`, {}, h("span", { "aria-hidden": "true" }, signs[state] ?? "○"), word ? ` ${word}` : "");
}

/** A sentence in a box of its state: bad, warn or good. */
export function said(state, ...children) {
  return h(`div.said.${state}`, {}, ...children);
}

/** Load a script of a library that is no module, once. */
export function script(path) {
  loaded[path] ??= new Promise((done, failed) => {
    document.head.append(h("script", { src: path, onload: done, onerror: () => failed(new Error(path)) }));
  });
  return loaded[path];
}

/** Load a style sheet, once. */
export function styles(path) {
  loaded[path] ??= new Promise((done) => document.head.append(h("link", { rel: "stylesheet", href: path, onload: done, onerror: done })));
  return loaded[path];
}

const loaded = {};
